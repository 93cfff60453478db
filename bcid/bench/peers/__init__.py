"""Other programs on the same problems, each written as its own documentation writes it."""
