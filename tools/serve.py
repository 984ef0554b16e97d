"""`contramap serve`: the models stay loaded, and frames are answered over ZeroMQ."""

from __future__ import annotations

from ipaddress import ip_address

from mapping.errors import ConfigError


def serve(
    *,
    host: str = "127.0.0.1",
    port: int = 5560,
    max_mb: float = 64.0,
    preset: str = "tabletop",
    set: tuple[str, ...] = (),
) -> None:
    """Answer frames with meshes over ZeroMQ and msgpack, without the seconds a process needs to start.

    Example: contramap serve --port 5560

    A client is tools/serving/client.py: it needs numpy, pyzmq and msgpack only. There is no password: whoever
    reaches the port may ask. Stop it with Ctrl-C.

    Args:
        host: Address to listen on; only this machine can reach the default.
        port: Port to listen on; 0 takes a free one and prints it.
        max_mb: Largest message taken [MB].
        preset: tabletop or paper.
        set: Single settings, such as mesh.spacing=0.003.
    """
    from reconstruction.config import preset as preset_of
    from tools.options import pipeline_config
    from tools.serving.answers import Answers
    from tools.serving.server import Server

    if not 0 < max_mb <= 1024:
        raise ConfigError(f"--max-mb must lie above 0 and at most at 1024, got {max_mb:g}")
    if not 0 <= port <= 65535:
        raise ConfigError(f"--port must lie in 0..65535, got {port}")
    try:
        loopback = ip_address("127.0.0.1" if host == "localhost" else host).is_loopback
    except ValueError as error:
        raise ConfigError(f"--host must be an IP address, such as 127.0.0.1, got {host!r}") from error
    answers = Answers(pipeline_config(preset_of(preset), texts=set))
    server = Server(answers, "127.0.0.1" if host == "localhost" else host, port, int(max_mb * 1e6))
    try:
        answers.warm_up()
        if not loopback:
            print("note: reachable from other machines, without a password")
        print(f"contramap serves on {server.address}; Ctrl-C stops it", flush=True)
        server.serve()
    except KeyboardInterrupt:
        print("stopped")
    finally:
        server.close()
