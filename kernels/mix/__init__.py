"""Every pixel mixed from its neighbours by weights of its own: `mix`."""
