"""OmniSyn: the 360° video between two panoramas (Li et al., IEEE VR 2022), as a library and the command ``omnisyn``."""

__version__ = "0.1.0"
