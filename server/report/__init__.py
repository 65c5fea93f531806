"""The report as a page and as data: sections drawn, kept while they are made, and the command that makes them."""
