"""When two depths belong to one surface, and how near the nearest thing is: numbers that several rooms share.

Differences of inverse depth are relative to the greater of the two. They were chosen by eye unless a line says
otherwise.
"""

# Of two estimates: at two sizes, of two views, of neighbouring pixels. Both have errors of their own.
SAME_SURFACE_TOLERANCE = 0.1
# Of the two directions of matching, for things at middle distance. Stricter, as it decides what is known at all.
LEFT_RIGHT_TOLERANCE = 0.08
# At which a hidden surface is down to 1/e of its weight. A scale, not a limit: blending must not flip from pixel to
# pixel.
OCCLUSION_SCALE = 0.06
# Of one surface seen or sampled twice: only interpolation differs, so it is half of that of two estimates.
SAME_POINT_TOLERANCE = 0.05
# Between neighbouring vertices of a mesh: a surface is cut where it falls away more steeply than that.
MESH_CUT_STEP = 0.05
# Greatest √(inverse depth × baseline) that networks are shown or answer: a quarter of the baseline away.
MAX_SQRT_INV_DEPTH = 2.0
