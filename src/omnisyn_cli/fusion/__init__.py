"""One picture out of two renderings (paper, section 3.5)."""
