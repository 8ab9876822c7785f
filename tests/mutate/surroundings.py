"""Mutations of promises about pictures, sensors, adapters, targets of compilation, and the documentation."""

from tests.mutate.mutation import Mutation

MUTATIONS = [
    # -- pictures ------------------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/imaging/image_files.py",
        old="np.rint(np.clip(image, 0.0, 1.0) * 255.0)",
        new="(np.clip(image, 0.0, 1.0) * 255.0)",
        tests="tests/interfaces/test_image.py::test_floats_are_rounded_to_the_nearest_byte",
        promise="a picture of bytes comes back as it was saved",
    ),
    Mutation(
        path="wrt/imaging/cameras.py",
        old="return tangent * self.width / self.height, tangent",
        new="return tangent, tangent * self.height / self.width",
        tests="tests/interfaces/test_camera.py::test_fov_is_the_vertical_angle_between_the_edges",
        promise="the field of view of a camera is the vertical one",
    ),
    Mutation(
        path="kernels/shading/bsdf/fresnel.py",
        old="share = 0.5 * (parallel * parallel + perpendicular * perpendicular)",
        new="share = parallel * parallel",
        tests="tests/imaging/test_scattering.py::test_boundaries_by_closed_forms",
        promise="surfaces scatter light by the equations that are cited",
    ),
    Mutation(
        path="kernels/shading/emitters/light_sampling.py",
        old="found.density = distance * distance / (cosine * area)",
        new="found.density = distance * distance / area",
        tests="tests/imaging/test_light_transport.py::test_area_lights_by_form_factors",
        promise="light of lamps agrees with closed forms",
    ),
    Mutation(
        path="kernels/shading/film.py",
        old="openness = float(received.open_rays[i]) / float(received.ambient_samples)",
        new="openness = float(received.open_rays[i]) / float(received.ambient_samples + 1)",
        tests="tests/interfaces/test_render.py::test_ambient_distance_limits_what_darkens",
        promise="where no ambient ray is occluded, all of the sky arrives",
    ),
    # -- sensors -------------------------------------------------------------------------------------------------------
    Mutation(
        path="kernels/native/sensor_noise.h",
        old="c0 = unsigned(product_1 >> 32) ^ c1 ^ key_0;",
        new="c0 = unsigned(product_1 >> 32) ^ c1 ^ key_1;",
        tests="tests/sensors/test_philox.py::test_philox_known_answers",
        promise="noise is that of the published generator",
    ),
    Mutation(
        path="kernels/sensors/lidar_returns.py",
        old="        value = -distance\n",
        new="        value = distance\n",
        tests="tests/sensors/test_lidar.py::test_more_surfaces_than_returns",
        promise="a lidar that keeps the last return keeps the last one",
    ),
    # -- adapters ------------------------------------------------------------------------------------------------------
    Mutation(
        path="wrt/compat/trimesh_rays.py",
        old="key = hash(self.mesh)",
        new="key = id(self.mesh)",
        tests="tests/interfaces/test_trimesh_rays.py::test_follows_the_mesh",
        promise="the shape of trimesh follows its mesh",
    ),
    Mutation(
        path="wrt/compat/trimesh_rays.py",
        old="index_ray = np.flatnonzero(hits.is_hit)",
        new="index_ray = np.arange(len(origins))",
        tests="tests/interfaces/test_trimesh_rays.py::test_first_hits_and_bounds",
        promise="the shape of trimesh holds our answers: rays that miss have no row",
    ),
    # -- processes and targets -----------------------------------------------------------------------------------------
    Mutation(
        path="kernels/compilation/target.py",
        old='    "x86-64-v4": Target(("-target-cpu", "x86-64-v4", "-mprefer-vector-width=512"), AVX512, 512),',
        new='    "x86-64-v4": Target(("-target-cpu", "x86-64-v4", "-mprefer-vector-width=512"), AVX512, 256),',
        tests="tests/execution/test_target.py::test_widths_and_registers",
        promise="what depends on the width of vectors holds with 8 and with 16 lanes",
    ),
    Mutation(
        path="kernels/compilation/compile_progress.py",
        old="if chosen() is None and begins and not ends:",
        new="if chosen() and begins and not ends:",
        tests="tests/execution/test_compilation.py::test_a_process_says_once_that_it_compiles",
        promise="the first call says that it compiles, also into a pipe",
    ),
    Mutation(
        path="wrt/__init__.py",
        old="    __path__.append(str(Path(__file__).parents[1]))\n",
        new=(
            "    __path__.append(str(Path(__file__).parents[1]))\n"
            "    __import__('threading').Thread(target=__import__('time').sleep, args=(2,), daemon=True).start()\n"
        ),
        tests="tests/execution/test_pool.py::test_import_starts_no_thread",
        promise="`import wrt` starts no thread",
    ),
    # -- documentation -------------------------------------------------------------------------------------------------
    Mutation(
        path="docs/api/queries.md",
        old=".. autoclass:: wrt.AllHits\n",
        new="",
        tests="tests/pages/test_pages.py::test_every_public_name_is_in_the_reference",
        promise="every public name is in the reference",
    ),
    Mutation(
        path="wrt/cli/catalogue.py",
        old='"wrt.moving.SkinnedScene": (',
        new='"wrt.moving.SkinnedScenes": (',
        tests="tests/pages/test_algorithms.py::test_the_command_lists_what_the_page_lists",
        promise="the table of algorithms has a row for every entry, and `wrt list` lists it",
    ),
    Mutation(
        path="docs/algorithms.md",
        old="| `binned` (default) |",
        new="| `binned` |",
        tests="tests/pages/test_algorithms.py::test_defaults_are_marked",
        promise="the table of algorithms marks the defaults",
    ),
    Mutation(
        path="wrt/meshes/skeleton.py",
        old="def sample(self, count: int, seed: int = 0)",
        new="def sample(self, count: int, seed: int = 0, burn_in: int = 0)",
        tests="tests/pages/test_docs.py::test_arguments_are_explained",
        promise="the docstring of a public name explains every argument",
    ),
]
