"""Triangle tests that "auto" never chooses (contract and table: `wrt.kernels.triangle`)."""
