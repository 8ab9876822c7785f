"""`python -m wrt.bench`: the same as `wrt bench`."""

from wrt.bench.commands.benchmark import bench

bench(prog_name="python -m wrt.bench")
