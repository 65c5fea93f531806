"""The domain of isogi: volumes, light, kernels, bakes, the cache and frames. No web, no
scheduler.
"""
