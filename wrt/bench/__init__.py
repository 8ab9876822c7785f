"""The benchmark: wrt beside its peers, as ratios measured side by side in one run.

    commands/   `wrt bench` and what it compares: options, tables, files
    comparisons/  what is measured: queries, builds and start-up of all peers (query_comparison.py, build_comparison.py,
                startup_times.py), threads (thread_scaling.py), what "auto" chooses (auto_cases.py, auto_choices.py),
                closest points (point_comparison.py)
    peers/      the contenders, all with the same interface (peer.py): engines.py is wrt, embree.py Embree's C library
    core/       the rays (workloads.py), timing in turns (paired_timing.py), agreement, results, reports

Imports go from top to bottom of this list, never up.

Speed lives here and not in the tests: machines are noisy, so every figure is a ratio to wrt taken in the same round.
"""
