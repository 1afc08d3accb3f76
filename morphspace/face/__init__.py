"""Where the face is in a picture: its detector, mesh, faceframe, regions, expression and registration."""
