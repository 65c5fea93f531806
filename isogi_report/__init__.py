"""The report of a view, which measures the cost and the error of its light, and the speed of this
machine.

It needs the extra ``report``: ``pip install 'isogi[report]'``. Suites of benchmarks use it, too.
"""
