"""What each kind of result draws."""
