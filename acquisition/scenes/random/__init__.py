"""Random scenes and rigs to train networks on, by two renderers; no other scene looks like them."""
