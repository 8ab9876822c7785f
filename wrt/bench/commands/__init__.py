"""`wrt bench` and its commands: options, tables and files. What is measured is in `wrt.bench.comparisons`."""
