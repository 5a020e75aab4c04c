"""The main flow, the paper on a page: depth, surfaces and frames of every pair along a path."""
