"""Newton's method for a load step, the way of the plates, and the ways in which it ends."""
