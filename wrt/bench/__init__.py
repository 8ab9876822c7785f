"""The benchmark: wrt beside its peers, as ratios measured side by side in one run.

    workloads.py    the rays that are asked
    peers.py        the libraries that answer them, all with the same face (engines.py: wrt itself)
    measure.py      who is faster: contenders take turns, ratios round by round; who is right: agreement with wrt
    questions.py    closest hits and occlusion        builds.py   building trees        startup.py   the first second
    results.py      what was measured, as plain data  report.py, plot.py   the same as tables and as a picture
    command.py      `wrt bench`                         loading.py      what commands share

Within wrt:

    bare.py             triangle tests without a tree       triangle_tests.py   every test: speed, cost, exits
    precision.py        errors against float64, leaks       triangle_report.py, triangle_command.py
    komatsu.py          the tables of Komatsu et al. 2008   kdtree_builders.py, layouts.py  how kd-trees are built and laid out
    kdtree_study.py     what else papers on kd-trees claim  kdtree_pictures.py  kd-trees drawn

Speed lives here and not in the tests: machines are noisy, so every figure is a ratio to wrt taken in the same round.
"""
