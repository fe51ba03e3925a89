"""The live process: a `mrtask.live` team behind standard input and output or a WebSocket, and clients of it."""
