"""Panoramas with exact depth from textured meshes. Needs Embree (``pip install "omnisyn-cli[scenes]"``)."""
