from .server import ServeRequest as ServeRequest, serve as serve
