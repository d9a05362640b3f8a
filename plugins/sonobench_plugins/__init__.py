"""The bundled algorithms: a folder a role, a file an algorithm, registered like anybody's in `_register`."""
