"""Cullings of packets that "auto" never chooses (contract and table: `wrt.kernels.traversal.packet`)."""
