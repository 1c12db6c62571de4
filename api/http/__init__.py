"""The HTTP side of the service: everything between a socket and a call of the service.

    app                          puts routes and middleware together
    server                       `skyfolio serve`: safe settings, uvicorn, start and stop
    middleware                   admission of each request (host, origin, key, limits), log, metrics, audit
    origin_checks, proxies, connections, response_headers    the parts of admission, and headers that pages need
    problems                     the one table from exceptions to RFC 9457 responses
    docs_page                    `/docs`, offline
    routes/                      one file per resource: parse, call one part of the service, render

It may import every room of the service, and of `dashboard` no more than `mount` and `port`; `lab` never. Routes decide
nothing: a rule that a client can break belongs to the room that owns the data, and raises one of `common.errors`.
Paths, fields and problem types are a contract with clients: add, never rename.
"""
