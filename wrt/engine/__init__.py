"""From rays to hits. A query passes these in order:

1. `rays`: the caller's arrays are checked, brought to the device or read where they lie, and looked at.
2. `facts`: the kind of query; the scene's state, which never changes; the cache beside it.
3. `plan`: which traversal, triangle test and options answer the query.
4. `launch`: the plan's kernel and its arguments, prepared and kept for the next call; instances, lazy trees, areas.
5. `device_hits`: the results in device memory.

`executor` calls each; `memory` and `host_arrays` hold what they allocate; `background` runs tasks beside queries.
"""
