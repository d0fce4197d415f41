"""Built-in plugins, one a file. They enter by the same door as a stranger's."""
