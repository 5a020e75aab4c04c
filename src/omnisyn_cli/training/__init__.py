"""Making the networks from data the program makes itself: samples, losses, the loop, checkpoints."""
