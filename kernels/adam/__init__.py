"""One step of Adam on several tensors: `adam`."""
