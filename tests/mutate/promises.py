"""Mutations of promises about arrays, memory, queries and gradients, threads, and hostile geometry."""

from tests.mutate.mutation import Mutation

MUTATIONS = [
    # -- hits ----------------------------------------------------------------------------------------------------------
    Mutation(
        path="kernels/answers/skipped_triangle.py",
        old="return Skipping(t_min, skipped[i % skipped.shape[0]])",
        new="return Skipping(t_min, skipped[0])",
        tests="tests/queries/test_skip.py::test_shapes_and_kinds",
        promise="`skip` is the mesh without the triangle, for each ray its own",
    ),
    Mutation(
        path="wrt/query/skip.py",
        old="if not skip.is_of(scene):",
        new="if skip is None:",
        tests="tests/contracts/test_misuse.py::test_hits_of_another_scene_are_refused",
        promise="hits of another scene are refused",
    ),
    Mutation(
        path="wrt/engine/rays/ray_integers.py",
        old="values.min() < low or",
        new="",
        tests="tests/queries/test_skip.py::test_bad_arguments",
        promise="numbers of triangles that do not exist are refused",
    ),
    Mutation(
        path="kernels/query/open_segments.py",
        old="in_order = is_ordered(one, other)",
        new="in_order = is_ordered(one, one)",
        tests="tests/queries/test_visibility.py::test_who_is_seen_sees",
        promise="who is seen sees",
    ),
    Mutation(
        path="kernels/query/open_segments.py",
        old="return not (passes_through(mesh, primitive, start, rounding) or passes_through(mesh, primitive, end, rounding))",
        new="return not passes_through(mesh, primitive, start, rounding)",
        tests="tests/queries/test_visibility.py::test_convex_body",
        promise="the surface on which an end point lies does not hide it",
    ),
    Mutation(
        path="wrt/query/inside.py",
        old="aimed(few, DIRECTIONS[2], scene.device)",
        new="aimed(few, DIRECTIONS[1], scene.device)",
        tests="tests/queries/test_contains.py::test_contains_votes_where_the_mesh_has_a_hole",
        promise="where the mesh has a hole, three directions vote",
    ),
    Mutation(
        path="kernels/layout/ray_batch.py",
        old="ray.t_max = wp.where(t_max > FARTHEST, FARTHEST, t_max)",
        new="ray.t_max = t_max",
        tests="tests/triangles/test_short_directions.py::test_a_hit_beyond_float32_is_none",
        promise="no hit is at infinity",
    ),
    Mutation(
        path="wrt/query/exact_hits.py",
        old="exact.t_min, exact.t_min_stride = _exact_array(rays.t_min, buffers, (), device)",
        new="exact.t_min, exact.t_min_stride = _exact_array(np.zeros(()), buffers, (), device)",
        tests="tests/queries/test_precision.py::test_range_and_types",
        promise="`precise=True` is brute force in float64, within the range of each ray",
    ),
    # -- scenes --------------------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/meshes/node_graph.py",
        old="changed[number] |= parent != NOWHERE and changed[parent]",
        new="changed[number] |= parent != NOWHERE and changed[number]",
        tests="tests/scenes/test_node_graph.py::test_nodes_move_by_name",
        promise="a node of a scene's graph moves what hangs on it",
    ),
    Mutation(
        path="kernels/layout/instance_maps.py",
        old="mask = rays.mask[i * rays.mask_stride]",
        new="mask = rays.mask[0]",
        tests="tests/scenes/test_instances.py::test_masks[bvh]",
        promise="rays meet the instances of their own masks",
    ),
    Mutation(
        path="kernels/layout/instance_maps.py",
        old="environment = rays.environment[i * rays.environment_stride]",
        new="environment = rays.environment[0]",
        tests="tests/scenes/test_environments.py::test_as_the_instances_of_an_environment_asked_alone",
        promise="rays of an environment see its instances and the shared ones",
    ),
    Mutation(
        path="wrt/disk/part_loading.py",
        old="if known is not None and known.identity == identity and known.tree is not None:",
        new="if known is not None and known.tree is not None:",
        tests="tests/scenes/test_partitioned.py::test_a_file_that_was_written_again_is_checked_again",
        promise="a part's file that has changed is checked again",
    ),
    Mutation(
        path="wrt/disk/part_loading.py",
        old='if str(arrays["label"]) != label_of(self.parts.mark, number):',
        new='if not str(arrays["label"]):',
        tests="tests/scenes/test_partitioned.py::test_damaged_parts_are_refused",
        promise="parts of other scenes are refused",
    ),
    Mutation(
        path="wrt/scene/archives.py",
        old="if CHECKSUM not in arrays or str(arrays.pop(CHECKSUM)) != checksum(arrays):",
        new="if CHECKSUM not in arrays or not arrays.pop(CHECKSUM):",
        tests="tests/contracts/test_misuse.py::test_a_forged_scene_is_refused",
        promise="damaged files are refused",
    ),
    # -- arrays and memory ---------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/meshes/mesh_arrays.py",
        old="return np.frombuffer(array.tobytes(), dtype=array.dtype).reshape(array.shape)",
        new="return array",
        tests="tests/scenes/test_mesh.py::test_arrays_are_read_only",
        promise="no later write to an array that a mesh was made of changes anything",
    ),
    Mutation(
        path="wrt/meshes/mesh_arrays.py",
        old="array = frozen(array)  # copied before the check: the caller could change the original",
        new="pass",
        tests="tests/scenes/test_mesh.py::test_indices_are_checked_in_the_copy",
        promise="indices are checked in the copy that kernels read",
    ),
    Mutation(
        path="wrt/engine/memory.py",
        old="if size <= block.nbytes <= 2 * size]",
        new="if block.nbytes <= 2 * size]",
        tests=(
            "tests/execution/test_memory.py::test_blocks_come_back",
            "tests/execution/test_memory.py::test_too_small_a_block_stays",
        ),
        promise="memory that is used again is as large as what is asked for",
    ),
    Mutation(
        path="wrt/engine/memory.py",
        old="return keep_alive(wp.array(ptr=pointer, dtype=dtype, shape=count, capacity=size, device=device), lease)",
        new="return wp.array(ptr=pointer, dtype=dtype, shape=count, capacity=size, device=device)",
        tests="tests/execution/test_memory.py::test_arrays_share_memory_only_one_after_the_other",
        promise="results that are held keep their memory",
    ),
    Mutation(
        path="wrt/engine/memory.py",
        old='" bytes on device " not in str(error)',
        new='" bytes on device " in str(error)',
        tests="tests/execution/test_memory.py::test_failed_allocations_say_for_what",
        promise="too little memory is a `MemoryError` that says for what",
    ),
    # -- gradients -----------------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/tapes.py",
        old="if tape_records() and any(",
        new="if not tape_records() and any(",
        tests="tests/queries/test_gradients.py::test_queries_do_not_lose_gradients_in_silence[cpu-origins-intersect]",
        promise="inside a `wp.Tape` no gradient is lost without an error",
    ),
    Mutation(
        path="kernels/query/hit_gradients.py",
        old="return specialised_kernel(intersect_triangles, gradients=True)",
        new="return specialised_kernel(intersect_triangles)",
        tests="tests/queries/test_gradients.py::test_finite_differences[cpu-t]",
        promise="gradients of hits are those of finite differences",
    ),
    # -- threads and interrupts ----------------------------------------------------------------------------------------
    Mutation(
        path="kernels/runtime/pool.py",
        old="return _private_slot() if slot.is_busy else slot",
        new="return slot",
        tests="tests/execution/test_pool.py::test_a_signal_handler_may_ask",
        promise="a signal handler may query while a query runs",
    ),
    Mutation(
        path="kernels/runtime/pool.py",
        old="    _pool, _pool_lock = None, threading.Lock()\n\n\nif hasattr",
        new="    _pool_lock = threading.Lock()\n\n\nif hasattr",
        tests="tests/execution/test_pool.py::test_fork_during_queries",
        promise="processes may be forked at any moment",
    ),
    Mutation(
        path="kernels/runtime/pool.py",
        old="            return Slot(self._job_queue, self._free.popleft(), self._free)",
        new="            return Slot(self._job_queue, self._free.popleft())",
        tests="tests/execution/test_pool.py::test_slots_come_back_when_their_threads_end",
        promise="any number of threads may query, one after the other",
    ),
    Mutation(
        path="kernels/runtime/pool.py",
        old="self._interrupted.append((slot, (job, used)))",
        new="self._interrupted.append((slot, None))",
        tests="tests/execution/test_pool.py::test_an_interrupted_wait_frees_nothing_that_helpers_use",
        promise="after Ctrl-C, nothing that helpers still use is freed",
    ),
    # -- hostile geometry ----------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/meshes/mesh.py",
        old="points = self._vertices if self.referenced.all() else self._vertices[self.referenced]",
        new="points = self._vertices if self.referenced.any() else self._vertices[self.referenced]",
        tests="tests/scenes/test_mesh.py::test_bounds_ignore_unused_vertices",
        promise="vertices that no triangle uses affect no answer",
    ),
    Mutation(
        path="wrt/meshes/mesh_arrays.py",
        old="if array.min() < 0 or array.max() >= vertex_count:",
        new="if array.min() < 0 or array.max() > vertex_count:",
        tests="tests/scenes/test_mesh.py::test_bad_arrays",
        promise="indices of vertices that do not exist are refused",
    ),
    # -- verification --------------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/query/verification.py",
        old="return not any((*self.misses.values(), *self.false_hits.values(), self.inside.wrong))",
        new="return not any((*self.misses.values(), self.inside.wrong))",
        tests="tests/queries/test_verification.py::test_any_wrong_answer_is_not_ok",
        promise="the answer on your mesh can be checked, and faults are reported",
    ),
]
