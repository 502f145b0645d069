"""Evidence for the wire: what a hand and its host promise, tried and judged. Nothing here is needed to drive a hand."""
