"""Built-in plugins, one a file. They are loaded through the same interface as anybody's."""
