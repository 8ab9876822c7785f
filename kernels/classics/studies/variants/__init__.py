"""Variants of tests and traversals that no scene uses: for measurements."""
