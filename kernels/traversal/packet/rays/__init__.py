"""The rays of a packet: their numbers, their layout in memory, and their bounds."""
