"""First detection: where in a picture is the face, with nothing known of the last one."""
