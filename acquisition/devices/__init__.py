"""Cameras behind USB: the wire protocol, the device model, its mock and the driver."""
