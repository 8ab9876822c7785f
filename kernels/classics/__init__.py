"""What the tables list and "auto" never chooses: a published method a file, to be read beside its paper.

These modules import the engine, and no module of the engine imports them: rows of its tables name them
(`wrt.kernels.on_demand`, `wrt.kernels.triangle.support.triangle_contract`), and they are imported when they are asked for. They
give the same hits as the rest of their tables and pass the same tests, which are marked `classics`.

    triangle/    triangle tests besides `woop`, `moeller_trumbore` and `wald`: rows of `wrt.kernels.triangle.TRIANGLE_TESTS`
    traversal/   entry points, omnidirectional and repacked packets, frusta of eye rays: rows of
                 `wrt.kernels.traversal.TRAVERSALS`; mailboxes
    culling/     cullings of packets by corner rays and by frusta, and none: rows of `wrt.kernels.traversal.packet.CULLINGS`
    studies/     kernels of measurements: tests without a tree, counts, variants that no scene uses
"""
