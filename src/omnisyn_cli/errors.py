"""What can go wrong for a user, as a tree of exceptions.

Every message is one line that says what was expected, what was found and what to do next.

::

    OmnisynError            exit code 1: it was tried and failed
    ├── InputError          exit code 3: what was given cannot be used
    │   ├── ImageError          a panorama, mask or depth file
    │   ├── PoseError           a pose file, or poses that contradict each other
    │   └── OutputPathError     the place to write to: exists already, no such folder, not writable
    ├── EncodingError       ffmpeg refused or stopped; its own words are in the message
    ├── TrainingError       a run of training has collapsed
    └── WriteError          the disk is full, or the file went away while it was written
"""


class OmnisynError(Exception):
    """Base of everything this package raises on purpose."""

    exit_code = 1


class InputError(OmnisynError):
    """What was given cannot be used; nothing has been written."""

    exit_code = 3


class ImageError(InputError):
    """A panorama, mask or depth file is missing, damaged or has the wrong shape."""


class PoseError(InputError):
    """A pose file is malformed, or its poses are not rigid, not finite or not there."""


class OutputPathError(InputError):
    """The output exists already, has no folder, cannot be written or has an unknown extension."""


class EncodingError(OmnisynError):
    """The video encoder refused its input or stopped early."""


class TrainingError(OmnisynError):
    """Training went wrong and would not recover by itself."""


class WriteError(OmnisynError):
    """Writing failed after the work had begun: full disk, lost folder, lost permission."""
