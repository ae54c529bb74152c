"""How many threads the libraries of linear algebra may start."""

# Threads inside linear algebra on matrices of eight columns cost more than they bring, the more so
# beside other processes. Libraries read these when they are loaded.
LIBRARY_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
