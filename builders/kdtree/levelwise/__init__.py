"""In-place construction as a GPU means it: one thread a few events, all levels together down to the leaves."""
