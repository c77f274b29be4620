"""The command line: each command parses, calls one library function, and prints."""

import gc

# Imports make some hundred thousand objects that live as long as the program; looking for garbage
# among them even once takes longer than some imports and finds none. So this comes before them.
gc.set_threshold(500_000, 50, 50)
