"""Mutations of types: numbers, switches, arrays, devices and graph captures at the public border."""

from tests.mutate.mutation import Mutation

NUMBERS = "tests/contracts/test_number_types.py::test_numbers_of_every_type"
ARRAYS = "tests/contracts/test_foreign_arrays.py"
CAPTURE = "tests/contracts/test_graph_capture.py::test_what_needs_results_at_once_is_refused"
SAME = "Numbers, switches and arrays of every type mean the same in every public call, or are refused with the argument's name"
GRAPHS = "While a graph is captured, what needs results at once is refused before anything runs"
DEVICES = "A device may be named as other libraries name it; one that is not there is refused by the constructor"

MUTATIONS = [
    Mutation(
        path="wrt/sensors/lidar.py",
        old="        convert_fields(self)\n",
        new="",
        tests=f"{NUMBERS}[Lidar]",
        promise=SAME,
    ),
    Mutation(
        path="wrt/imaging/integrators/render_settings.py",
        old="        convert_fields(self)\n",
        new="",
        tests=f"{NUMBERS}[RenderSettings]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old="_NO_NUMBERS = (bool, np.timedelta64)",
        new="_NO_NUMBERS = (np.timedelta64,)",
        tests=f"{NUMBERS}[set_num_threads]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old="_NO_NUMBERS = (bool, np.timedelta64)",
        new="_NO_NUMBERS = (bool,)",
        tests=f"{NUMBERS}[Bvh]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old="        value = bool(scalar)\n",
        new="        value = scalar\n",
        tests=f"{NUMBERS}[UpdatePolicy]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old="    if value != value:\n",
        new="    if False:\n",
        tests=f"{NUMBERS}[LidarPattern.raster]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old="        if np.ma.is_masked(values):\n",
        new="        if False:\n",
        tests=f"{ARRAYS}::test_arrays_that_mean_something_else[masked values]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old="    return values.resolve_neg() if callable(is_negative) and is_negative() else values\n",
        new="    return values\n",
        tests=f"{ARRAYS}::test_tensors_that_are_negated_when_read[origins]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old='return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))',
        new="return array",
        tests=f"{ARRAYS}::test_rays_and_vertices_in_arrays_of_any_form[big-endian]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/validation.py",
        old='    if getattr(values, "requires_grad", False):\n',
        new="    if False:\n",
        tests=f"{ARRAYS}::test_tensors_that_record_gradients[origins]",
        promise=SAME,
    ),
    Mutation(
        path="wrt/query/query_options.py",
        old='as_bool("cull_backfaces", query.cull_backfaces)',
        new="query.cull_backfaces",
        tests=f"{NUMBERS}[Queries.occluded]",
        promise=SAME,
    ),
    Mutation(
        path="kernels/runtime/launch.py",
        old='    if kind == "cpu":\n        if number is not None and int(number):\n',
        new='    if kind == "cpu":\n        if False:\n',
        tests="tests/execution/test_devices.py::test_devices_that_are_not_there",
        promise=DEVICES,
    ),
    Mutation(
        path="kernels/runtime/launch.py",
        old="re.IGNORECASE)",
        new="0)",
        tests="tests/execution/test_devices.py::test_the_cpu_by_any_name",
        promise=DEVICES,
    ),
    Mutation(
        path="wrt/compat/open3d_rays.py",
        old="None if device is None else as_device(device).alias",
        new="device",
        tests="tests/execution/test_devices.py::test_devices_that_are_not_there",
        promise=DEVICES,
    ),
    Mutation(
        path="wrt/sensors/lidar.py",
        old="        refuse_captured_scan(scene.device, path, motions, to_warp)\n",
        new="",
        tests=f"{CAPTURE}[scan]",
        promise=GRAPHS,
    ),
    Mutation(
        path="wrt/query/points/visibility.py",
        old='    refuse_capture("visible", scene.device)\n',
        new="",
        tests=f"{CAPTURE}[visible]",
        promise=GRAPHS,
    ),
    Mutation(
        path="wrt/scene/scene.py",
        old='        refuse_capture("an update", self.device)\n',
        new="",
        tests=f"{CAPTURE}[instances]",
        promise=GRAPHS,
    ),
    Mutation(
        path="wrt/query/inside.py",
        old='    scene.require("count")\n',
        new="",
        tests="tests/triangles/test_fan_scene.py::test_queries_that_count_are_refused_at_once",
        promise="Wrong arguments are a `TypeError` or a `ValueError` before any kernel runs",
    ),
    Mutation(
        path="kernels/sensors/lenses.py",
        old="        shift = lens.skew * y\n",
        new="        shift = -lens.skew * y\n",
        tests="tests/sensors/test_lenses.py::test_camera_matrices_with_skew",
        promise="Lenses equal OpenCV's and closed forms",
    ),
]
