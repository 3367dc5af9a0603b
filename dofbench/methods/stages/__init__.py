"""Which stages of a method a training set needs."""
