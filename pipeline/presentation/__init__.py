"""Tables, their files and statistics over seeds, shared by the report and the studies."""
