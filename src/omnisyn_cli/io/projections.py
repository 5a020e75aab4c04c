"""What pictures show that are no panoramas of 2:1, by their shape and their samples, and what to do about each."""

import numpy as np
from jaxtyping import Bool, Shaped

LAYOUT_ROWS = 128  # rows that are looked at to tell what a picture of unusual shape shows
# Of the halves of top-bottom stereo; the sky and the ground of one picture have next to none. Set by hand.
MIN_STEREO_CORRELATION = 0.7
# Of what columns 1/64 of the width apart differ by, that the first and the last column do; spheres have a third of it
# at the most, other pictures at least twice as much.
MAX_SEAM_STEP = 0.75
# Of the contrast of a sphere's rows that its first or its last row has, which show one point. Set by hand.
MAX_POLE_SHARE = 0.5
# Of white, that the largest sample of a black pixel has at most: compression makes black margins a little grey.
MAX_BLACK = 0.06
MIN_BLACK_SHARE = 0.98  # of the pixels of a row, a column or a corner that are black there
# Of the pixels in a disc that are not black; those of dark rooms have more.
MIN_LIT_SHARE = 0.5
MAX_PLAIN_CONTRAST = 0.02  # standard deviation of what is between the arms of a cross, in the contrast of the picture
MARGIN_TOLERANCE = 0.02  # of the height of what black margins surround, by which it may miss 2:1
MIN_LIT_HEIGHT = 0.8  # of its true height, if it begins at the top: its own ground may be black

GENERAL_REMEDY = (
    "; stitch it to 2:1, or allow other aspect ratios (--allow-aspect) if the image does cover the whole sphere, or "
    "say what it covers (--hfov)"
)

Picture = Shaped[np.ndarray, "height width channels"]  # samples of any type

CUBE = ": six faces of a cube{}; convert it to equirectangular first{}"


def described_shape(picture: Picture, peak: float) -> str:
    """What a picture that is not 2:1 seems to be, and the remedy; ``peak`` is white."""
    height, width = picture.shape[:2]
    if found := described_margins(picture, peak):
        return f": {found}"
    if width == 6 * height or height == 6 * width:
        where, form = (" in a row", "c6x1") if width > height else (" in a column", "c1x6")
        return CUBE.format(where, f" (ffmpeg -vf v360={form}:e)")
    if _is_cross(picture):
        return CUBE.format(" in a cross", ", for example with Hugin")
    if width == height:
        return "; use the upper half of top-bottom stereo (--upper-half), or allow other aspect ratios (--allow-aspect)"
    if width > 2 * height and seam_share(picture) <= MAX_SEAM_STEP:
        return (
            ": a full turn whose ends meet; say --hfov 360 if it is a sphere cut above and below, convert a cylinder "
            "first (ffmpeg -vf v360=cylindrical:e)"
        )
    return GENERAL_REMEDY


def described_sphere(picture: Picture, peak: float) -> str | None:
    """The same of a picture of 2:1; None where it may be a panorama."""
    if _are_discs(_reduced(picture) > MAX_BLACK * peak):
        return "two fisheye pictures side by side (two discs, dark corners); stitch it first, with the camera's program"
    return described_margins(picture, peak)


def described_margins(picture: Picture, peak: float) -> str | None:
    """Which part of a picture is a panorama of 2:1 within black margins, if one is."""
    if all(_reduced(edge).max(initial=0) > MAX_BLACK * peak for edge in (picture[-1:], picture[:, -1:])):
        return None
    (height, width), step = picture.shape[:2], max(1, len(picture) // LAYOUT_ROWS)
    lit = [part.max(axis=2) > MAX_BLACK * peak for part in (picture[:, ::step], picture[::step])]
    rows, cols = (np.flatnonzero(each.mean(axis=1 - k) > 1.0 - MIN_BLACK_SHARE) for k, each in enumerate(lit))
    if not len(rows) or 2 * (cols[-1] - cols[0]) < width:
        return None
    top, left, high, wide = int(rows[0]), int(cols[0]), int(rows[-1] - rows[0]) + 1, int(cols[-1] - cols[0]) + 1
    is_margin = wide < (1.0 - MARGIN_TOLERANCE) * width or 2 * height > (1.0 + MARGIN_TOLERANCE) * width
    least = MIN_LIT_HEIGHT if top == 0 else 1.0 - MARGIN_TOLERANCE
    if not is_margin or not least * wide < 2 * high < (1.0 + MARGIN_TOLERANCE) * wide:
        return None
    return f"a panorama with black margins; crop it to {wide // 2 * 2}×{wide // 2} at column {left}, row {top}"


def are_stacked_alike(picture: Picture) -> bool:
    """Whether the upper and the lower half of a picture show the same, as in top-bottom stereo."""
    step = max(1, len(picture) // LAYOUT_ROWS)
    halves = [half[::step, ::step].astype(np.float64).ravel() for half in np.split(picture[: len(picture) // 2 * 2], 2)]
    centred = [half - half.mean() for half in halves]
    alike = float(centred[0] @ centred[1]) / (float(np.prod([np.linalg.norm(half) for half in centred])) or 1.0)
    return alike > MIN_STEREO_CORRELATION


def is_sphere(picture: Picture) -> bool:
    """Whether a picture closes at its seam and shows one point at each pole, though it may be squeezed."""
    rows = picture[:: max(1, len(picture) // LAYOUT_ROWS)].astype(np.float64)
    poles = min(row.std(axis=0).mean() for row in (rows[0], picture[-1].astype(np.float64)))
    return seam_share(picture) <= MAX_SEAM_STEP and bool(poles <= MAX_POLE_SHARE * rows.std(axis=1).mean())


def seam_share(picture: Picture) -> float:
    """How much the first column differs from the last one, in what columns 1/64 of the width apart differ by."""
    rows = picture[:: max(1, len(picture) // LAYOUT_ROWS)].astype(np.float64)
    beside = float(np.abs(np.diff(rows[:, :: max(1, picture.shape[1] // 64)], axis=1)).mean())
    across = float(np.abs(rows[:, 0] - rows[:, -1]).mean())
    return across / beside if beside else float(across > 0.0)


def _reduced(picture: Picture) -> Shaped[np.ndarray, "rows cols"]:
    """The largest sample of some pixels."""
    step = max(1, max(picture.shape[:2]) // (2 * LAYOUT_ROWS))
    return np.asarray(picture[::step, ::step].max(axis=2))


def _are_discs(is_lit: Bool[np.ndarray, "rows cols"]) -> bool:
    """Whether both halves are black outside of a disc, and lit in it as far up and down as they are black beside it."""
    for half in np.split(is_lit[:, : is_lit.shape[1] // 2 * 2], 2, axis=1):
        y, x = (np.abs((np.arange(size) + 0.5) / size * 2.0 - 1.0) for size in half.shape)
        radius = np.hypot(y[:, None], x[None])
        caps = (radius < 0.9) & (y > 0.75)[:, None]
        outside = half[radius > 1.02]
        if not outside.size or outside.mean() > 1.0 - MIN_BLACK_SHARE or half[caps].mean() < MIN_LIT_SHARE:
            return False
    return True


def _is_cross(picture: Picture) -> bool:
    """Whether cells of 4×3 or 3×4 are plain but for those of a cross."""
    height, width = picture.shape[:2]
    down, across = (4, 3) if height > width else (3, 4)
    if abs(height * across - width * down) > MARGIN_TOLERANCE * max(height, width):
        return False
    rows, cols = height // down, width // across
    cells = picture[: rows * down, : cols * across].reshape(down, rows, across, cols, -1)
    inner = cells[:, rows // 16 : rows - rows // 16, :, cols // 16 : cols - cols // 16].astype(np.float64)
    is_plain = inner.std(axis=(1, 3)).max(axis=-1) < MAX_PLAIN_CONTRAST * float(np.ptp(picture))
    is_arm = np.arange(down)[:, None] == 1
    crosses = [is_arm | (np.arange(across) == centre) for centre in range(across)]
    return any(is_plain[~cross].all() and not is_plain[cross].all() for cross in crosses)
