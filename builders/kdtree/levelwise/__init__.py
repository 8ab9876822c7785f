"""In-place construction as a GPU means it: all levels together down to the leaves.

levelwise_build   the build: sort, level after level, numbers in depth-first order
paired_events     two events of each triangle on each axis
cell_nodes        the nodes of a level: their best planes and their children
event_moves       events to the children of their nodes
numbering         nodes in depth-first order
level_memory      arrays, kept from one build to the next
grid_sums         sums and least values of all threads of a launch
"""
