"""``isogi store``: looking after the store of light, beside servers that use it."""
