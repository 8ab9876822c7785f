"""The walks of packets, and their steps through nodes, cells and leaves."""
