"""Starting the nodes of a configuration, by script or by launch file."""
