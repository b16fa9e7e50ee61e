"""Run a network on images: by OpenVINO or torch, on the CPU or a GPU."""
