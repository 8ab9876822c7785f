"""Triangle fans: meshes as fans on a device, scenes whose trees have leaves of fans, and files of fans."""
