"""Depth of a pair of panoramas by classical stereo, without a network."""
