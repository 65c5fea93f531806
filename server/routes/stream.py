"""A scene as a stream of pictures."""

from fastapi import APIRouter, WebSocket

from isogi_core.errors import IsogiError
from server.problems import problem, status_of
from server.service import ServiceDep
from server.stream.session import Session

router = APIRouter(prefix="/v1/scenes/{scene}")


@router.websocket("/stream")
async def stream(socket: WebSocket, scene: str, service: ServiceDep) -> None:
    """The client sends views, the newest wins: drafts while it moves, the full picture at rest, better as light comes.

    Refused with a problem before it begins where the scene is unknown, or too many streams are open.
    """
    try:
        found = service.scene(scene)
        with service.connections.admitted():
            await socket.accept()
            await Session(socket, service, found).run()
    except IsogiError as error:
        await socket.send_denial_response(problem(status_of(error), str(error), socket.url.path))
