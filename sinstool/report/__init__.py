"""Figures and the page that shows them; matplotlib is imported when it draws."""
