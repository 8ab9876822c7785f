"""What is measured: queries, builds and start-up beside peers, numbers of threads, and what "auto" chooses."""
