"""Mutations of `contains` and its check, of compiled kernels on disk, of native code for other CPUs, and of forged trees."""

from tests.mutate.mutation import Mutation

REPEATED = "tests/queries/test_repeated_surfaces.py"
DAMAGED = "tests/execution/test_damaged_kernels.py"
TARGETS = "tests/contracts/test_native_targets.py"
FORGED = "tests/scenes/test_forged_trees.py"

MUTATIONS = [
    Mutation(
        path="wrt/query/inside.py",
        old="        scene = scene.distinct()\n",
        new="",
        tests=f"{REPEATED}::test_a_surface_that_is_written_twice_is_there_once[all twice-bvh]",
        promise="A triangle that repeats an earlier one does not change `contains`",
    ),
    Mutation(
        path="wrt/meshes/repeated_surfaces.py",
        old="    return np.take_along_axis(corners, order[:, :, None], axis=1)",
        new="    return corners",
        tests=f"{REPEATED}::test_a_surface_that_is_written_twice_is_there_once[all twice, other corners first-bvh]",
        promise="A triangle that repeats an earlier one does not change `contains`",
    ),
    Mutation(
        path="wrt/meshes/repeated_surfaces.py",
        old="    order = (smallest[:, None] + np.arange(3)) % 3\n",
        new="    order = np.argsort(corners @ [1.0, 3.0, 9.0], axis=1)\n",
        tests=f"{REPEATED}::test_a_surface_that_is_written_twice_is_there_once[both sides of every face-bvh]",
        promise="A triangle that is turned over repeats nothing",
    ),
    Mutation(
        path="wrt/meshes/repeated_surfaces.py",
        old="np.where(others % 2 == 1, 1, -1)",
        new="1",
        tests=f"{REPEATED}::test_a_surface_that_is_written_twice_is_there_once[one in another on the same ground-bvh]",
        promise="A repeated triangle that closes another body stays",
    ),
    Mutation(
        path="wrt/meshes/repeated_surfaces.py",
        old="        if any(number == other or are_equal(mesh, meshes[other]) for other in others):\n            continue\n",
        new="",
        tests=f"{REPEATED}::test_instances",
        promise="An instance that repeats an earlier one does not change `contains`",
    ),
    Mutation(
        path="wrt/query/verification.py",
        old="*self.false_hits.values(), self.inside.wrong))",
        new="*self.false_hits.values()))",
        tests=f"{REPEATED}::test_verify_finds_a_wrong_parity",
        promise="`verify` finds wrong answers of `contains`",
    ),
    Mutation(
        path="wrt/query/verification.py",
        old='"no answer of intersect and occluded is wrong" if self.inside.doubts else "no answer is wrong"',
        new='"no answer is wrong"',
        tests=f"{REPEATED}::test_verify_says_what_contains_cannot_answer",
        promise="`verify` does not end with 'no answer is wrong' where `contains` is in doubt",
    ),
    Mutation(
        path="kernels/compilation/kernel_cache.py",
        old="        _remove(code.parent, error)\n        return False\n",
        new="        raise\n",
        tests=f"{DAMAGED}::test_a_damaged_cache_that_cannot_be_mended",
        promise="Damaged compiled kernels are compiled again",
    ),
    Mutation(
        path="kernels/compilation/kernel_cache.py",
        old="        error = find_fault(wp.config.kernel_cache_dir)\n",
        new="        error = None\n",
        tests=f"{DAMAGED}::test_a_cache_that_cannot_be_written_while_a_module_loads",
        promise="A kernel cache that cannot be written is replaced, also while a module loads",
    ),
    Mutation(
        path="kernels/compilation/kernel_cache.py",
        old="    leave_full_disk()\n    try:\n",
        new="    try:\n",
        tests=f"{DAMAGED}::test_a_full_cache_is_left_before_anything_is_compiled",
        promise="A kernel cache without room is left before LLVM ends the process",
    ),
    Mutation(
        path="kernels/compilation/damaged_kernels.py",
        old="        if checksum(code, about).encode() != sealed:\n",
        new="        if False:\n",
        tests=f"{DAMAGED}::test_shipped_kernels_with_another_checksum_are_compiled",
        promise="Compiled kernels whose bytes have changed do not run",
    ),
    Mutation(
        path="kernels/compilation/shipped_kernels.py",
        old="            damage = damage_of(code, about)\n",
        new="            damage = None\n",
        tests=f"{DAMAGED}::test_shipped_kernels_with_another_checksum_are_compiled",
        promise="Compiled kernels whose bytes have changed do not run",
    ),
    Mutation(
        path="kernels/native/pool.h",
        old="    __builtin_arm_yield();",
        new='    __asm__ volatile("yield");',
        tests=f"{TARGETS}::test_threads_relax_by_a_builtin_on_arm",
        promise="Native code has no instructions in assembly",
    ),
    Mutation(
        path="kernels/native/shading_vectors.h",
        old="lanes_in(FIRST_LANES_FIRST.of[mask])",
        new="lanes_in(LAST_LANES_FIRST.of[mask])",
        tests=f"{TARGETS}::test_width_and_target_are_independent[8-x86-64-v3]",
        promise="Any number of lanes compiles for any target",
    ),
    Mutation(
        path="builders/tree_check.py",
        old="        if depth > MAX_TREE_DEPTH or len(below) > count:\n",
        new="        if len(below) > count:\n",
        tests=f"{FORGED}::test_the_depth_of_a_path_is_bounded",
        promise="A kd-tree from outside is not deeper than stacks",
    ),
    Mutation(
        path="builders/tree_check.py",
        old="    if tree.pairs is not None:\n",
        new="    if False:\n",
        tests=f"{FORGED}::test_pairs_are_those_of_the_tree",
        promise="Nodes in pairs from outside are those of their tree",
    ),
    Mutation(
        path="builders/tree_check.py",
        old="        if places.min() < 0 or places.max() + 1 > len(pairs):\n",
        new="        if places.max() + 1 > len(pairs):\n",
        tests=f"{FORGED}::test_pairs_are_those_of_the_tree",
        promise="Nodes in pairs from outside are those of their tree",
    ),
    Mutation(
        path="builders/tree_check.py",
        old="        if not np.logical_and(*same).all():\n",
        new="        if False:\n",
        tests=f"{FORGED}::test_pairs_are_those_of_the_tree",
        promise="Nodes in pairs from outside are those of their tree",
    ),
    Mutation(
        path="wrt/scene/storage.py",
        old="(values < NOWHERE).any() or (values >= end).any()",
        new="(values >= end).any()",
        tests=f"{FORGED}::test_numbers_of_nodes_are_in_range",
        promise="A graph from outside has numbers of nodes that exist",
    ),
    Mutation(
        path="wrt/scene/storage.py",
        old="(values < NOWHERE).any() or (values >= end).any()",
        new="(values < NOWHERE).any()",
        tests=f"{FORGED}::test_numbers_of_nodes_are_in_range",
        promise="A graph from outside has numbers of nodes that exist",
    ),
]
