"""The report of a view, and the speed of this machine: what isogi's light costs and how wrong it
is, measured.

It works with the extra ``report``: ``pip install 'isogi[report]'``. Suites of benchmarks measure
with it, too.
"""
