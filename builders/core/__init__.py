"""What builders of trees of all kinds share: levels of large nodes, subtrees of tasks, lists of references, clipping."""
