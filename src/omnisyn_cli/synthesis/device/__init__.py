"""Frames made on a GPU: surfaces rasterised, coloured, exposed, blended, filled and rounded by torch on one device.

The processor's way of making frames (:mod:`omnisyn_cli.render`, :mod:`omnisyn_cli.fusion`) decides what they look like;
here the same rules are written for arrays of pixels. Nothing in these modules asks what the device is, so that tests
run the very same code on a processor.
"""
