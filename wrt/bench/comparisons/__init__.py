"""What is measured: queries, builds and start-up beside peers, closest points, numbers of threads, and what "auto" chooses."""
