"""The order of rays: coherence detection, sorting, orders for packets, and how much of a tree the rays of packets share."""
