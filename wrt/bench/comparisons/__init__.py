"""What is measured: peers beside wrt, threads, animations, and the claims of papers in the folders below."""
