"""The contenders, all with the same interface (`wrt.bench.peers.peer`), and their table."""
