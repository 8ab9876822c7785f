"""What scenes of instances consist of: boxes and the trees over them, small updates, tables for traversals, members."""
