"""Which test next: protocols within a rig's limits, what each is expected to tell, and the files of the answer."""
