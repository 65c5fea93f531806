"""Deferral: a picture that is not final yet is answered with a job that bakes it, and that tells where it then is."""

from __future__ import annotations

from collections.abc import Iterable
from urllib.parse import urlencode

from fastapi import Response

from server.completion import complete
from server.headers import entity_tag
from server.jobs import Job, Result
from server.order import Order
from server.params import FrameParams
from server.pictures import MEDIA_TYPES
from server.service import Service
from server.statuses import address, job_facts

OWN = ("f", "version", "wait_ms")
"""Parameters that an address of the final picture has of its own, or needs not."""


def defer(
    service: Service, order: Order, params: FrameParams, query: list[tuple[str, str]], looks: tuple[str, float]
) -> Response:
    """202 and a job that has the light of an order baked; ``query`` are the parameters as they were given.

    ``looks`` are the format and the exposure of the picture. Raises BusyError.
    """
    form, exposure = looks

    async def work(job: Job) -> Iterable[Result]:
        frame = await complete(service, order, job)
        tag = entity_tag(frame, form, exposure, params.overlay, params.max_error)
        named = [*(pair for pair in query if pair[0] not in OWN), ("f", form), ("version", tag.strip('"'))]
        href = f"/v1/scenes/{order.scene}/frame?{urlencode(named)}"
        return [Result(href, MEDIA_TYPES[form], "The final picture")]

    job = service.jobs.begin("frame", f"A frame of {order.scene}", work)
    headers = {"Location": address(job), "Preference-Applied": "respond-async", "Cache-Control": "no-store"}
    return Response(
        job_facts(job).model_dump_json(), 202, headers | {"Vary": "Accept, Prefer"}, media_type="application/json"
    )
