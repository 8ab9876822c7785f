"""Lockstep traversal: each lane of a vector walks its own ray."""
