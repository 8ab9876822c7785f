"""Kd-trees: from comparing every plane with every triangle (`naive`) to the builds that sort once (`sweep`, `nested`).

Builders: `naive`, `sorting_sweep`, `sweep`, `nested`, `streaming`, `adaptive_sampling`, `medians`, `between_medians`, and for
them early cutting of empty space (`early_cutting`). Of finished trees: `postprocess`, `node_layouts`, `compact_subtrees`.
"""
