"""The verdict on runs: whether a network works, the first cause why not, and its cure."""
