"""What a rendered depth says: the disparity of its surfaces, their circles of confusion, and how far it is from known
depth."""
