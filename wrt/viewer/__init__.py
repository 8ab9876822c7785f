"""The live viewer: a scene in a web browser, ray-traced while the camera moves. It needs the package viser (`wrt[view]`).

* `live_view`: `wrt.view`, and the server that all clients share.
* `web_server`: the server before it has a scene.
* `addresses`: who may speak to it: tokens, and names of this computer.
* `connections`: limits on connections, and their ends.
* `shared_scene`: the scene that is shown: its versions, and what changes it while it runs.
* `browser`: one browser: what a session asks of viser.
* `client_session`: its pictures and its camera.
* `session_life`: the states of a session.
* `frame_loop`: the thread that makes the pictures of a client; it knows neither viser nor scenes.
* `pictures`: what a picture shows: light, layers of hits, or the cost of its rays.
* `trees`: the traversal path of a ray, and the boxes of its levels, as lines.
* `panels`: the parts of the control panel.
"""
