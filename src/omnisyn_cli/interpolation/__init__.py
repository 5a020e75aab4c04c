"""From files to a video: what ``omnisyn interpolate`` does, as a library.

``plan`` reads and checks what can be known without decoding a picture, so that nothing fails after minutes of work that
could have been known before; ``run`` does the work. Nothing appears under its final name unless all of it succeeded.
"""
