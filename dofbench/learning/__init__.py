"""What methods share, whatever they render with: learned lenses, depth supervision and priors, photographs' colours."""
