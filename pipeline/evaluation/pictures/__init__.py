"""Images and videos: of views, of depth and flow, along a path of the camera."""
