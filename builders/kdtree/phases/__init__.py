"""Phases of kd-tree builds: top levels, tasks, subtrees, and assembly."""
