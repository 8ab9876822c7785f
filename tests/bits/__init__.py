"""Hashes of hits, trees and pictures, to see whether a change of the code kept every bit.

`python -m tests.bits --write` computes all cases for this CPU's width and keeps the hashes in `hashes.json` beside this file;
without an option they are compared with those. `WRT_WIDTH` and `WRT_TARGET` choose the width and the CPU's instructions.

* **Hits** have one hash for every engine: the same on each tree and traversal, at each width, for each target and device. So a
  case names a scene, a query and a triangle test, and all engines that answer it are held against one hash.
* **Trees** depend on the width: a hash for each scene, builder and width.
* **Pictures** are hashed for each integrator and width.

A hash that changes on purpose is written again in the commit that changes it, with the reason in its message. Files that users
keep depend on these results, so that commit also raises a number in `wrt/revisions.py`: `--write` refuses changed hashes until
then, and notes in `revisions.json` at which revision the hashes of each family were recorded. A raised revision is recorded
for every width: run `--write --what trees` with each. New cases need no new revision.
"""
