"""Trimming: sharp light of isovalues that nobody looks at any more goes, so that a store holds a bounded part of it."""

import logging
from dataclasses import replace

from isogi_core.cache.census import census_of
from isogi_core.cache.pruning import Wish, plan_of, prune
from isogi_core.cache.root import Root
from isogi_core.errors import StoreError

log = logging.getLogger("isogi.cache")


def trim_sharp(root: Root, most: int) -> int:
    """Delete sharp layers, the longest unused first, until those at ``root`` have ``most`` bytes; how many went.

    What was written in the last minute stays. A store that does not tell ages, or takes nothing now, is left as it is.
    """
    try:
        census = census_of(root, texels=False)
        counts = {d: count for d, count in census.counts.items() if count.facts.attributes.get("shown") is not None}
        plan = plan_of(replace(census, counts=counts), Wish(keep=most), root.now())
        prune(root, census, plan)
    except StoreError as error:
        log.info("Sharp light is not trimmed: %s", error)
        return 0
    return len(plan.going)
