"""Traversals that "auto" never chooses, and mailboxes (contract and table: `wrt.kernels.traversal`)."""
