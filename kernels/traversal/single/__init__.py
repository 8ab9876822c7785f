"""One ray at a time: walks of kd-trees and BVHs, and the kernels around them."""
