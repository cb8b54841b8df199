"""What a picture is: the camera that took it, pictures and videos as files."""
