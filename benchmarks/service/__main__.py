"""``python -m benchmarks.service``."""

from benchmarks.common.suite import suite
from benchmarks.service.drag import drag
from benchmarks.service.far_away import far_away
from benchmarks.service.first_look import first_look
from benchmarks.service.first_start import first_start
from benchmarks.service.fuzz import fuzz
from benchmarks.service.load import load
from benchmarks.service.malformed import malformed
from benchmarks.service.memory import memory
from benchmarks.service.page import page
from benchmarks.service.routes import routes
from benchmarks.service.time_left import time_left
from benchmarks.service.visitors import visitors
from benchmarks.service.warm_view import warm_view
from benchmarks.service.widget import widget

main = suite(
    "One server, as its clients see it.",
    *(
        drag,
        visitors,
        load,
        malformed,
        memory,
        fuzz,
        warm_view,
        page,
        routes,
        time_left,
        widget,
        first_look,
        first_start,
        far_away,
    ),
)

if __name__ == "__main__":
    main(prog_name="python -m benchmarks.service")
