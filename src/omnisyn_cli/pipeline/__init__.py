"""What users choose: presets, and the sources of depth, renderers, fusions and methods that they are made of.

Importing this takes no time, so that commands offer the names before anything is loaded. Each strategy makes what it
names, and imports it then.
"""
