"""Mutations of the viewer: who may speak to it, the life of its sessions, its limits, and how it ends."""

from tests.mutate.mutation import Mutation

ADDRESSES, CONNECTIONS, SESSIONS = (f"tests/viewer/test_{name}.py" for name in ("addresses", "connections", "client_sessions"))
HERE = "A viewer on this computer answers no page of another site, under whatever name"
LIFE = "A browser that leaves, at whatever moment, leaves no thread, session, connection or memory behind"
NONSENSE = "What browsers send, or do not send, ends their own session at most"

MUTATIONS = [
    Mutation(
        path="wrt/viewer/addresses.py",
        old='return name == "localhost" if isinstance(name, str)',
        new='return name.startswith(("localhost", "127.")) if isinstance(name, str)',
        tests=(f"{ADDRESSES}::test_other_names", f"{ADDRESSES}::test_interfaces_of_this_computer"),
        promise=HERE,
    ),
    Mutation(
        path="wrt/viewer/addresses.py",
        old="if len(hosts) != 1 or len(origins) > 1:",
        new="if not hosts or len(origins) > 1:",
        tests=f"{ADDRESSES}::test_headers_that_are_missing_or_several",
        promise=HERE,
    ),
    Mutation(
        path="wrt/viewer/addresses.py",
        old="return path if not origins or is_page_of(origins[0], server) else None",
        new="return path",
        tests=f"{ADDRESSES}::test_pages",
        promise=HERE,
    ),
    Mutation(
        path="wrt/viewer/addresses.py",
        old="return not self.only_here and (not isinstance(name, str) or",
        new="return (not isinstance(name, str) or",
        tests=f"{ADDRESSES}::test_other_names",
        promise=HERE,
    ),
    Mutation(
        path="wrt/viewer/addresses.py",
        old="(page[1] or default) == (server[1] or default)",
        new="True",
        tests=f"{ADDRESSES}::test_pages",
        promise=HERE,
    ),
    Mutation(
        path="wrt/viewer/session_life.py",
        old="if self._state is not before:",
        new="if False:",
        tests=f"{SESSIONS}::test_states_follow_one_another",
        promise=LIFE,
    ),
    Mutation(
        path="wrt/viewer/client_session.py",
        old="            self._room.set()\n        elif",
        new="        elif",
        tests=f"{SESSIONS}::test_hundreds_of_clients_leave_at_any_moment",
        promise=LIFE,
    ),
    Mutation(
        path="wrt/viewer/client_session.py",
        old="            self._loop.stop()\n",
        new="",
        tests=f"{SESSIONS}::test_hundreds_of_clients_leave_at_any_moment",
        promise=LIFE,
    ),
    Mutation(
        path="wrt/viewer/frame_loop.py",
        old="            self._ended(failed)",
        new="            self._ended(None)",
        tests=f"{SESSIONS}::test_an_error_that_nobody_foresaw_ends_the_session",
        promise="An error while pictures are made is told to the user, and the session goes on or is over",
    ),
    Mutation(
        path="wrt/viewer/web_server.py",
        old="        if connection.is_open:",
        new="        if True:",
        tests=f"{CONNECTIONS}::test_a_camera_that_is_read_after_the_end",
        promise=LIFE,
    ),
    Mutation(
        path="wrt/viewer/web_server.py",
        old="            self.viser._connected_clients.pop(number, None)",
        new="            pass",
        tests=f"{CONNECTIONS}::test_a_camera_that_is_read_after_the_end",
        promise=LIFE,
    ),
    Mutation(
        path="wrt/viewer/connections.py",
        old='"max_size": MESSAGE_BYTES,',
        new='"max_size": 1 << 40,',
        tests=f"{CONNECTIONS}::test_messages_that_cannot_be_read",
        promise=NONSENSE,
    ),
    Mutation(
        path="wrt/viewer/connections.py",
        old="    if not connection.has_spoken:",
        new="    if False:",
        tests=f"{CONNECTIONS}::test_who_says_nothing_is_dismissed",
        promise=NONSENSE,
    ),
    Mutation(
        path="wrt/viewer/connections.py",
        old="or len(self.open) >= MAX_CONNECTIONS:",
        new="or False:",
        tests=f"{CONNECTIONS}::test_too_many_connections",
        promise=NONSENSE,
    ),
    Mutation(
        path="wrt/viewer/browser.py",
        old="np.isfinite(point).all() and ",
        new="",
        tests=f"{CONNECTIONS}::test_cameras_that_make_no_sense",
        promise=NONSENSE,
    ),
    Mutation(
        path="wrt/viewer/browser.py",
        old="return int(min(max(value, 1.0), LONGEST_SIDE))",
        new="return int(max(value, 1.0))",
        tests=f"{CONNECTIONS}::test_sizes_of_windows",
        promise=NONSENSE,
    ),
    Mutation(
        path="wrt/viewer/client_session.py",
        old="        self._room.wait()\n",
        new="",
        tests=f"{CONNECTIONS}::test_a_page_in_the_background",
        promise="A browser gets the next picture when it has received the one before",
    ),
    Mutation(
        path="wrt/viewer/live_view.py",
        old="            if self._is_full:",
        new="            if False:",
        tests=f"{CONNECTIONS}::test_whoever_waits_gets_the_next_place",
        promise="16 browsers get pictures; others are told, and get the next free place",
    ),
    Mutation(
        path="wrt/viewer/shared_scene.py",
        old="        return self._current\n",
        new="        with self._lock:\n            return self._current\n",
        tests=f"{CONNECTIONS}::test_the_scene_changes_while_it_is_shown",
        promise="Pictures go on while a tree is built",
    ),
    Mutation(
        path="kernels/compilation/module_compiler.py",
        old="        if _is_exiting:  # a new",
        new="        if False:  # a new",
        tests="tests/execution/test_compilation.py::test_a_thread_that_asks_for_kernels_at_the_exit",
        promise="A process with a viewer ends: after `close`, at a Ctrl-C, and by itself",
    ),
    Mutation(
        path="wrt/viewer/pictures/looks.py",
        old='given["ambient_radius"] = max(COARSE_RADIUS, given.get("ambient_radius", 0))',
        new='given["ambient_radius"] = 0',
        tests="tests/viewer/test_viewer_pictures.py::test_coarse_pictures_have_no_black_speckles",
        promise="Coarse pictures of dark places are dark, not black and white",
    ),
    Mutation(
        path="kernels/shading/ambient.py",
        old="                            found_alike += open_rays[other]",
        new="                            found_alike += open_rays[item]",
        tests="tests/viewer/test_viewer_pictures.py::test_pixels_share_their_ambient_rays",
        promise="With `ambient_radius`, a pixel's ambient light is the mean over its neighbours on the same smooth surface",
    ),
]
