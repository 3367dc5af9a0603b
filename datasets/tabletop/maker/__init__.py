"""Makes the built-in scene: procedural textures and props, a camera path, a path-traced render, sparse points."""
