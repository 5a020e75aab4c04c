"""Meshes on the sphere and how to see them from elsewhere: mesh → rasterize → shade (paper, section 3.4)."""
