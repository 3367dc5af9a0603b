"""Values, files and errors that everything else is built on: nothing here knows what a scene or a method is."""
