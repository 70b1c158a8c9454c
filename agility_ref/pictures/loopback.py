"""Loopback: the live page is for browsers of this machine, and for pages of its own.

A stranger's page in the visitor's browser reaches 127.0.0.1 too: directly, or under the stranger's name, which
may be made to point there (DNS rebinding).  The headers Host and Origin tell it from ours.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"


@contextmanager
def refusing_strangers() -> Iterator[None]:
    """Let the server of websockets that viser starts in this block refuse, with status 403, what is not asked of this machine."""
    from websockets.asyncio import server

    def serve(*args, process_request, **options):
        def answer(connection, request):
            named = [f"//{host}" for host in request.headers.get_all("Host")] + request.headers.get_all("Origin")
            if any(urlsplit(url).hostname not in (LOOPBACK, "localhost") for url in named):
                return connection.respond(403, f"this page is for {LOOPBACK} alone\n")
            return process_request(connection, request)

        return original(*args, process_request=answer, **options)

    original, server.serve = server.serve, serve
    try:
        yield
    finally:
        server.serve = original
