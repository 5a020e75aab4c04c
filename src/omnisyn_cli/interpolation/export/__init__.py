"""A tour as a thing for other programs: a textured mesh, points, discs, or a data set with depth.

``docs/export.md`` states axes, units and origin of every format; each is read back in the tests by a reader of others.
"""
