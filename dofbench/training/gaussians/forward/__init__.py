"""Forward models: how Gaussians and a lens become a photograph with shallow depth of field. One model per file."""
