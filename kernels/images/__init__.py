"""Images that kernels read: which texels lie around texture coordinates."""
