"""Where two panoramas were taken relative to each other, found in the pictures alone."""
