"""Parts of training that don't depend on the renderer: learned lenses, depth supervision and priors, photographs'
colours."""
