"""Mutations of what leaves the library: positions far from 0, narrow fields, files that replace others."""

from tests.mutate.mutation import Mutation

FAR = "tests/queries/test_far_positions.py"
FIELDS = "tests/sensors/test_table_fields.py"
POINTS = "tests/sensors/test_point_files.py"
ATOMIC = "tests/contracts/test_atomic_files.py"
DISK = "tests/contracts/test_full_disk.py"

WHOLE = "A file is written whole or not at all"
FULL = "A full disk is an error that names the file, and leaves the old one as it was"
UTM = "Positions far from 0 leave in float64, right to 2^-24 of the scene's extent"
NARROW = "Numbers in tables, LAS, bags and patterns do not wrap"

MUTATIONS = [
    Mutation(
        path="wrt/query/hits.py",
        old="return self._out(out) if self.is_far else self._as_dtype(out)",
        new="return self._as_dtype(out)",
        tests=f"{FAR}::test_rays_in_float32_find_points_that_are_on_the_surface",
        promise=UTM,
    ),
    Mutation(
        path="wrt/query/hits.py",
        old="FAR = 8.0",
        new="FAR = 80.0",
        tests=f"{FAR}::test_where_float32_holds_positions_they_are_float32",
        promise=UTM,
    ),
    Mutation(
        path="wrt/query/batches/block_outputs.py",
        old="array.dtype.itemsize < 8 and answer.is_far",
        new="array.dtype.itemsize < 4 and answer.is_far",
        tests=f"{FAR}::test_blocks_refuse_arrays_that_would_move_positions",
        promise=UTM,
    ),
    Mutation(
        path="wrt/meshes/exact_encoding.py",
        old="is_exact = bool((narrow == vertices).all())",
        new="is_exact = True",
        tests=f"{FAR}::test_mesh_files_keep_vertices_or_warn",
        promise=UTM,
    ),
    Mutation(
        path="wrt/meshes/exact_encoding.py",
        old="if moved > NOTICED * ",
        new="if moved > 1e9 * NOTICED * ",
        tests=f"{FAR}::test_mesh_files_keep_vertices_or_warn",
        promise=UTM,
    ),
    Mutation(
        path="wrt/sensors/lidar_scan.py",
        old='"<f8" if frame == "world" else "<f4"',
        new='"<f4"',
        tests=f"{POINTS}::test_tables_and_files_in_utm_coordinates",
        promise=UTM,
    ),
    Mutation(
        path="wrt/sensors/files/point_files.py",
        old="KITTI_ERROR = 1e-3",
        new="KITTI_ERROR = 1.0",
        tests=f"{POINTS}::test_tables_and_files_in_utm_coordinates",
        promise=UTM,
    ),
    Mutation(
        path="wrt/sensors/files/las_files.py",
        old="    if coarsest > step:\n        step = MAX_STEP\n",
        new="",
        tests=f"{POINTS}::test_las_steps_follow_from_the_data",
        promise=UTM,
    ),
    Mutation(
        path="wrt/compat/open3d_rays.py",
        old="FAR_CAMERA = 2.0**14",
        new="FAR_CAMERA = 2.0**24",
        tests=f"{FAR}::test_cameras_and_adapters",
        promise=UTM,
    ),
    Mutation(
        path="wrt/sensors/checks.py",
        old="(wide < float(limits.max) + 1.0)",
        new="(values <= limits.max)",
        tests=f"{FIELDS}::test_integers_fit_or_are_named",
        promise=NARROW,
    ),
    Mutation(
        path="wrt/sensors/lidar_pattern.py",
        old="as_integers(name, array, dtype) if dtype is np.int32 else array",
        new="array",
        tests=f"{FIELDS}::test_rings_of_a_pattern_do_not_wrap",
        promise=NARROW,
    ),
    Mutation(
        path="wrt/sensors/lidar_pattern.py",
        old="(self.rings.min() < 0 or self.rings.max() > np.iinfo(np.uint16).max)",
        new="self.rings.min() < 0",
        tests=f"{FIELDS}::test_tables_have_wider_fields_where_they_are_needed",
        promise=NARROW,
    ),
    Mutation(
        path="wrt/sensors/files/las_files.py",
        old='as_integers("points[\'ring\']", values, np.uint16, " in LAS files")',
        new="values.astype(np.uint16)",
        tests=f"{FIELDS}::test_las_fields_do_not_wrap",
        promise=NARROW,
    ),
    Mutation(
        path="wrt/sensors/files/bag_files.py",
        old="if len(kinds) > 1:",
        new="if len(kinds) > 2:",
        tests=f"{FIELDS}::test_a_topic_of_a_bag_has_one_kind",
        promise=NARROW,
    ),
    Mutation(
        path="wrt/sensors/files/bag_files.py",
        old="if not 0.0 <= one.start < MAX_SECONDS:",
        new="if not 0.0 <= one.start:",
        tests=f"{FIELDS}::test_a_topic_of_a_bag_has_one_kind",
        promise=NARROW,
    ),
    Mutation(
        path="wrt/atomic_files.py",
        old="    except BaseException:\n        temporary.unlink(missing_ok=True)\n        raise",
        new="    except Exception:\n        temporary.unlink(missing_ok=True)\n        raise",
        tests=f"{ATOMIC}::test_an_error_leaves_the_old_file_and_nothing_else",
        promise=WHOLE,
    ),
    Mutation(
        path="wrt/atomic_files.py",
        old="            _to_disk(temporary)",
        new="            pass",
        tests=f"{ATOMIC}::test_older_contents_are_replaced_when_the_new_ones_are_on_the_disk",
        promise=WHOLE,
    ),
    Mutation(
        path="wrt/atomic_files.py",
        old='return path, int(found["number"])',
        new="return Path(os.path.realpath(path)), None",
        tests=f"{ATOMIC}::test_standard_output_is_not_replaced",
        promise=WHOLE,
    ),
    Mutation(
        path="wrt/atomic_files.py",
        old="if old is not None and not os.access(target, os.W_OK):",
        new="if False:",
        tests=f"{ATOMIC}::test_a_file_that_may_not_be_written_is_not_replaced",
        promise=WHOLE,
    ),
    Mutation(
        path="wrt/atomic_files.py",
        old="LONGEST = 30",
        new="LONGEST = 300",
        tests=f"{ATOMIC}::test_longest_names",
        promise=WHOLE,
    ),
    Mutation(
        path="wrt/imaging/image_files.py",
        old="    with replaced(path, streams=True) as file:\n        file.write(content.getbuffer())",
        new='    with open(path, "wb") as file:\n        file.write(content.getbuffer())',
        tests=f"{DISK}::test_the_old_file_stays[image.png]",
        promise=FULL,
    ),
    Mutation(
        path="wrt/sensors/files/bag_files.py",
        old="with new_folder(path) as folder:",
        new="for folder in [Path(path)]:",
        tests=f"{DISK}::test_a_bag_is_whole_or_not_there",
        promise=FULL,
    ),
]
