"""File formats: one file each, found by being here; `hdf5` is the process in which HDF5 files are opened."""
