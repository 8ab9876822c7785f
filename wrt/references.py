"""Works that docstrings cite, by key: `References: wald-havran-2006; rahikainen-2013 (section 4.1).`

A key is the first author, the second one if there are two, and the year; a word of the title where that is not enough. The page
"References" of the documentation is made of this table.
"""

REFERENCES = {
    "aila-2013": (
        "T. Aila, T. Karras, S. Laine: On quality metrics of bounding volume hierarchies. High Performance Graphics 2013."
    ),
    "aila-laine-2009": (
        "T. Aila, S. Laine: Understanding the efficiency of ray traversal on GPUs. High Performance Graphics 2009."
    ),
    "amanatides-choi-1997": "J. Amanatides, K. Choi: Ray tracing triangular meshes. Western Computer Graphics Symposium, 1997.",
    "andrew-1979": (
        "A. M. Andrew: Another efficient algorithm for convex hulls in two dimensions. Information Processing Letters "
        "9(5), 1979."
    ),
    "appleby-2011": "A. Appleby: MurmurHash3, 2011.",
    "apetrei-2014": (
        "C. Apetrei: Fast and simple agglomerative LBVH construction. Computer Graphics and Visual Computing (EG UK) 2014."
    ),
    "arnaldi-1987": (
        "B. Arnaldi, T. Priol, K. Bouatouch: A new space subdivision method for ray tracing CSG modelled scenes. The "
        "Visual Computer 3, 1987."
    ),
    "arvo-kirk-1990": "J. Arvo, D. Kirk: Particle transport and image synthesis. SIGGRAPH 1990.",
    "arya-mount-1993": "S. Arya, D. M. Mount: Algorithms for fast vector quantization. Data Compression Conference 1993.",
    "ashikhmin-shirley-2000": (
        "M. Ashikhmin, P. Shirley: An anisotropic Phong BRDF model. Journal of Graphics Tools 5(2), 2000."
    ),
    "asprs-2019": "American Society for Photogrammetry and Remote Sensing: LAS specification 1.4, revision 15. 2019.",
    "badouel-1990": "D. Badouel: An efficient ray-polygon intersection. Graphics Gems, Academic Press, 1990.",
    "baerentzen-aanaes-2005": (
        "J. A. Bærentzen, H. Aanæs: Signed distance computation using the angle weighted pseudonormal. IEEE Transactions on "
        "Visualization and Computer Graphics 11(3), 2005."
    ),
    "baldwin-weber-2016": (
        "D. Baldwin, M. Weber: Fast ray-triangle intersections by coordinate transformation. Journal of Computer Graphics "
        "Techniques 5(3), 2016."
    ),
    "barill-2018": (
        "G. Barill, N. G. Dickson, R. Schmidt, D. I. W. Levin, A. Jacobson: Fast winding numbers for soups and clouds. ACM "
        "Transactions on Graphics 37(4), 2018."
    ),
    "barringer-akenine-moeller-2014": (
        "R. Barringer, T. Akenine-Möller: Dynamic ray stream traversal. ACM Transactions on Graphics 33(4), 2014."
    ),
    "benthin-2006": "C. Benthin: Realtime ray tracing on current CPU architectures. PhD thesis, Saarland University, 2006.",
    "benthin-2018": (
        "C. Benthin, I. Wald, S. Woop, A. T. Áfra: Compressed-leaf bounding volume hierarchies. High Performance Graphics 2018."
    ),
    "benthin-2024": (
        "C. Benthin, D. Meister, J. Barczak, R. Mehalwal, J. Tsakok, A. Kensler: H-PLOC: hierarchical parallel "
        "locally-ordered clustering for bounding volume hierarchy construction. Proceedings of the ACM on Computer Graphics "
        "and Interactive Techniques 7(3), 2024."
    ),
    "benthin-wald-2009": (
        "C. Benthin, I. Wald: Efficient ray traced soft shadows using multi-frusta tracing. High Performance Graphics 2009."
    ),
    "bikker-2007": (
        "J. Bikker: Real-time ray tracing through the eyes of a game developer. IEEE Symposium on Interactive Ray Tracing 2007."
    ),
    "bittner-2013": (
        "J. Bittner, M. Hapala, V. Havran: Fast insertion-based optimization of bounding volume hierarchies. Computer "
        "Graphics Forum 32(1), 2013."
    ),
    "blumofe-leiserson-1999": (
        "R. D. Blumofe, C. E. Leiserson: Scheduling multithreaded computations by work stealing. Journal of the ACM "
        "46(5), 1999."
    ),
    "boulos-2006": (
        "S. Boulos, I. Wald, P. Shirley: Geometric and arithmetic culling methods for entire ray packets. Technical "
        "report UUCS-06-010, University of Utah, 2006."
    ),
    "boulos-2007": (
        "S. Boulos, D. Edwards, J. D. Lacewell, J. Kniss, J. Kautz, P. Shirley, I. Wald: Packet-based Whitted and "
        "distribution ray tracing. Graphics Interface 2007."
    ),
    "boulos-2008": (
        "S. Boulos, I. Wald, C. Benthin: Adaptive ray packet reordering. IEEE Symposium on Interactive Ray Tracing 2008."
    ),
    "box-muller-1958": (
        "G. E. P. Box, M. E. Muller: A note on the generation of random normal deviates. Annals of Mathematical "
        "Statistics 29(2), 1958."
    ),
    "brown-1966": "D. C. Brown: Decentering distortion of lenses. Photogrammetric Engineering 32(3), 1966.",
    "burley-2020": "B. Burley: Practical hash-based Owen scrambling. Journal of Computer Graphics Techniques 9(4), 2020.",
    "cadet-lecussan-2007": (
        "G. Cadet, B. Lecussan: Coupled use of BSP and BVH trees in order to exploit ray bundle performance. IEEE "
        "Symposium on Interactive Ray Tracing, 2007."
    ),
    "choi-2010": (
        "B. Choi, R. Komuravelli, V. Lu, H. Sung, R. L. Bocchino, S. V. Adve, J. C. Hart: Parallel SAH k-D tree "
        "construction. High Performance Graphics 2010."
    ),
    "cigolle-2014": (
        "Z. H. Cigolle et al.: A survey of efficient representations for independent unit vectors. Journal of Computer "
        "Graphics Techniques 3(2), 2014."
    ),
    "cook-1984": "R. L. Cook, T. Porter, L. Carpenter: Distributed ray tracing. SIGGRAPH 1984.",
    "cook-1986": "R. L. Cook: Stochastic sampling in computer graphics. ACM Transactions on Graphics 5(1), 1986.",
    "cranley-patterson-1976": (
        "R. Cranley, T. N. L. Patterson: Randomization of number theoretic methods for multiple integration. SIAM Journal "
        "on Numerical Analysis 13(6), 1976."
    ),
    "crow-1987": "F. C. Crow: The origins of the teapot. IEEE Computer Graphics and Applications 7(1), 1987.",
    "dammertz-2008": (
        "H. Dammertz, J. Hanika, A. Keller: Shallow bounding volume hierarchies for fast SIMD ray tracing of incoherent "
        "rays. Eurographics Symposium on Rendering 2008."
    ),
    "dammertz-keller-2006": (
        "H. Dammertz, A. Keller: Improving ray tracing precision by object space intersection computation. IEEE Symposium "
        "on Interactive Ray Tracing, 2006."
    ),
    "davidovic-2012": (
        "T. Davidovic, T. Engelhardt, I. Georgiev, P. Slusallek, C. Dachsbacher: 3D rasterization: a bridge between "
        "rasterization and ray casting. Graphics Interface 2012."
    ),
    "dawson-haggerty": "M. Dawson-Haggerty et al.: trimesh, https://trimesh.org.",
    "dekker-1971": (
        "T. J. Dekker: A floating-point technique for extending the available precision. Numerische Mathematik 18, 1971."
    ),
    "dmitriev-2004": (
        "K. Dmitriev, V. Havran, H.-P. Seidel: Faster ray tracing with SIMD shaft culling. Research report "
        "MPI-I-2004-4-006, Max-Planck-Institut fuer Informatik, 2004."
    ),
    "duff-2017": (
        "T. Duff et al.: Building an orthonormal basis, revisited. Journal of Computer Graphics Techniques 6(1), 2017."
    ),
    "dupuy-benyoub-2023": (
        "J. Dupuy, A. Benyoub: Sampling visible GGX normals with spherical caps. Computer Graphics Forum 42(8), 2023."
    ),
    "edelsbrunner-muecke-1990": (
        "H. Edelsbrunner, E. P. Muecke: Simulation of simplicity: a technique to cope with degenerate cases in geometric "
        "algorithms. ACM Transactions on Graphics 9(1), 1990."
    ),
    "ericson-2005": "C. Ericson: Real-time collision detection. Morgan Kaufmann, 2005.",
    "ernst-greiner-2007": (
        "M. Ernst, G. Greiner: Early split clipping for bounding volume hierarchies. IEEE/EG Symposium on Interactive Ray "
        "Tracing 2007."
    ),
    "ernst-greiner-2008": (
        "M. Ernst, G. Greiner: Multi bounding volume hierarchies. IEEE Symposium on Interactive Ray Tracing 2008."
    ),
    "ester-1996": (
        "M. Ester, H.-P. Kriegel, J. Sander, X. Xu: A density-based algorithm for discovering clusters in large spatial "
        "databases with noise. KDD 1996."
    ),
    "fabianowski-2009": (
        "B. Fabianowski, C. Fowler, J. Dingliana: A cost metric for scene-interior ray origins. Eurographics 2009, short "
        "papers."
    ),
    "falcone-2024": (
        "L. Falcone: Ray distribution aware heuristics for bounding volume hierarchies construction in ray tracing. MSc "
        "thesis, Politecnico di Milano, 2024."
    ),
    "fischler-bolles-1981": (
        "M. A. Fischler, R. C. Bolles: Random sample consensus: a paradigm for model fitting with applications to image "
        "analysis and automated cartography. Communications of the ACM 24(6), 1981."
    ),
    "foley-sugerman-2005": (
        "T. Foley, J. Sugerman: KD-tree acceleration structures for a GPU raytracer. Graphics Hardware 2005."
    ),
    "fowler-2009": (
        "C. Fowler, S. Collins, M. Manzke: Accelerated entry point search algorithm for real-time ray-tracing. Spring "
        "Conference on Computer Graphics (SCCG) 2009."
    ),
    "fresnel-1823": "A. Fresnel: Memoire sur la loi des modifications que la reflexion imprime a la lumiere polarisee. 1823.",
    "fussell-subramanian-1988": (
        "D. S. Fussell, K. R. Subramanian: Fast ray tracing using k-d trees. Technical report TR-88-07, University of "
        "Texas, 1988."
    ),
    "galin-akkouche-2005": (
        "E. Galin, S. Akkouche: Fast processing of triangle meshes using triangle fans. Shape Modeling International 2005."
    ),
    "garanzha-loop-2010": (
        "K. Garanzha, C. Loop: Fast ray sorting and breadth-first packet traversal for GPU ray tracing. Eurographics 2010."
    ),
    "geometry-center-1996": "Geometry Center: Geomview manual, object file formats. University of Minnesota, 1996.",
    "goldsmith-salmon-1987": (
        "J. Goldsmith, J. Salmon: Automatic creation of object hierarchies for ray tracing. IEEE CG&A 7(5), 1987."
    ),
    "gonzalez-2010": (
        "Á. González: Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices. Mathematical "
        "Geosciences 42, 2010."
    ),
    "goral-1984": (
        "C. M. Goral, K. E. Torrance, D. P. Greenberg, B. Battaile: Modeling the interaction of light between diffuse "
        "surfaces. SIGGRAPH 1984."
    ),
    "gottschalk-1996": (
        "S. Gottschalk, M. C. Lin, D. Manocha: OBBTree: a hierarchical structure for rapid interference detection. "
        "SIGGRAPH 1996."
    ),
    "gribble-ramani-2008": (
        "C. P. Gribble, K. Ramani: Coherent ray tracing via stream filtering. IEEE Symposium on Interactive Ray Tracing 2008."
    ),
    "guenther-2006-motion": (
        "J. Guenther, H. Friedrich, I. Wald, H.-P. Seidel, P. Slusallek: Ray tracing animated scenes using motion "
        "decomposition. Computer Graphics Forum 25(3) (Eurographics 2006)."
    ),
    "guenther-2006-skinned": (
        "J. Guenther, H. Friedrich, H.-P. Seidel, P. Slusallek: Interactive ray tracing of skinned animations. The Visual "
        "Computer 22(9), 2006."
    ),
    "guenther-2007": (
        "J. Guenther, S. Popov, H.-P. Seidel, P. Slusallek: Realtime ray tracing on GPU with BVH-based packet traversal. IEEE "
        "Symposium on Interactive Ray Tracing 2007."
    ),
    "haeberli-akeley-1990": (
        "P. Haeberli, K. Akeley: The accumulation buffer: hardware support for high-quality rendering. SIGGRAPH 1990."
    ),
    "haines-2019": (
        "E. Haines, J. Guenther, T. Akenine-Moeller: Precision improvements for ray/sphere intersection. Ray Tracing Gems, "
        "chapter 7, 2019."
    ),
    "haines-greenberg-1986": (
        "E. A. Haines, D. P. Greenberg: The light buffer: a shadow-testing accelerator. IEEE Computer Graphics and "
        "Applications 6(9), 1986."
    ),
    "hall-greenberg-1983": (
        "R. A. Hall, D. P. Greenberg: A testbed for realistic image synthesis. IEEE Computer Graphics and Applications "
        "3(8), 1983."
    ),
    "halton-1960": (
        "J. H. Halton: On the efficiency of certain quasi-random sequences of points in evaluating multi-dimensional "
        "integrals. Numerische Mathematik 2, 1960."
    ),
    "hammersley-1960": (
        "J. M. Hammersley: Monte Carlo methods for solving multivariable problems. Annals of the New York Academy of "
        "Sciences 86(3), 1960."
    ),
    "hanika-2021": "J. Hanika: Hacking the shadow terminator. Ray Tracing Gems II, 2021.",
    "havel-herout-2010": (
        "J. Havel, A. Herout: Yet faster ray-triangle intersection (using SSE4). IEEE Transactions on Visualization and "
        "Computer Graphics 16(3), 2010."
    ),
    "havran-2001": "V. Havran: Heuristic ray shooting algorithms. PhD thesis, Czech Technical University in Prague, 2001.",
    "havran-bittner-2002": "V. Havran, J. Bittner: On improving kd-trees for ray shooting. WSCG 2002.",
    "heitz-2014": (
        "E. Heitz: Understanding the masking-shadowing function in microfacet-based BRDFs. Journal of Computer Graphics "
        "Techniques 3(2), 2014."
    ),
    "hoare-1961": "C. A. R. Hoare: Algorithm 65: Find. Communications of the ACM 4(7), 1961.",
    "honda-1971": (
        "H. Honda: Description of the form of trees by the parameters of the tree-like body: effects of the branching "
        "angle and the branch length on the shape of the tree-like body. Journal of Theoretical Biology 31, 1971."
    ),
    "horn-2007": (
        "D. R. Horn, J. Sugerman, M. Houston, P. Hanrahan: Interactive k-d tree GPU raytracing. Symposium on Interactive "
        "3D Graphics and Games (I3D) 2007."
    ),
    "hunt-2006": (
        "W. Hunt, W. R. Mark, G. Stoll: Fast kd-tree construction with an adaptive error-bounded heuristic. IEEE "
        "Symposium on Interactive Ray Tracing 2006."
    ),
    "hunt-2007": (
        "W. Hunt, W. R. Mark, D. Fussell: Fast and lazy build of acceleration structures from scene hierarchies. IEEE "
        "Symposium on Interactive Ray Tracing 2007."
    ),
    "hunt-2008": (
        "W. A. Hunt: Corrections to the surface area metric with respect to mail-boxing. IEEE Symposium on Interactive "
        "Ray Tracing 2008."
    ),
    "iec-61966-1999": "IEC 61966-2-1: 1999, Default RGB colour space, sRGB.",
    "ize-2013": "T. Ize: Robust BVH ray traversal. Journal of Computer Graphics Techniques 2(2), 2013.",
    "jackson-2007": (
        "C. Jackson, A. Barth, A. Bortz, W. Shao, D. Boneh: Protecting browsers from DNS rebinding attacks. ACM CCS 2007."
    ),
    "jacobson-2013": (
        "A. Jacobson, L. Kavan, O. Sorkine-Hornung: Robust inside-outside segmentation using generalized winding numbers. ACM "
        "Transactions on Graphics 32(4), 2013."
    ),
    "jimenez-2010": (
        "J. J. Jimenez, R. J. Segura, F. R. Feito: A robust segment/triangle intersection algorithm for interference "
        "tests. Efficiency study. Computational Geometry 43(5), 2010."
    ),
    "kajiya-1986": "J. T. Kajiya: The rendering equation. SIGGRAPH 1986.",
    "kamel-faloutsos-1993": "I. Kamel, C. Faloutsos: On packing R-trees. CIKM 1993.",
    "kang-2013": (
        "Y.-S. Kang, J.-H. Nah, W.-C. Park, S.-B. Yang: gkDtree: a group-based parallel update kd-tree for interactive "
        "ray tracing. Journal of Systems Architecture 59, 2013."
    ),
    "kannala-brandt-2006": (
        "J. Kannala, S. S. Brandt: A generic camera model and calibration method for conventional, wide-angle, and fish- "
        "eye lenses. IEEE Transactions on Pattern Analysis and Machine Intelligence 28(8), 2006."
    ),
    "kay-kajiya-1986": "T. L. Kay, J. T. Kajiya: Ray tracing complex scenes. SIGGRAPH 1986.",
    "karras-2012": (
        "T. Karras: Maximizing parallelism in the construction of BVHs, octrees, and k-d trees. High Performance Graphics 2012."
    ),
    "kensler-2013": "A. Kensler: Correlated multi-jittered sampling. Pixar technical memo 13-01, 2013.",
    "kensler-shirley-2006": (
        "A. Kensler, P. Shirley: Optimizing ray-triangle intersection via automated search. IEEE Symposium on Interactive "
        "Ray Tracing, 2006."
    ),
    "khronos-gltf-2021": "Khronos Group: glTF 2.0 specification, appendix B, BRDF implementation. 2021.",
    "khronos-gltf-2022": "Khronos 3D Formats Working Group: glTF 2.0 specification. ISO/IEC 12113:2022.",
    "kirk-arvo-1991": "D. Kirk, J. Arvo: Unbiased sampling techniques for image synthesis. SIGGRAPH 1991.",
    "kollig-keller-2002": "T. Kollig, A. Keller: Efficient multidimensional sampling. Eurographics 2002.",
    "komatsu-2008": (
        "K. Komatsu, Y. Kaeriyama, K. Suzuki, H. Takizawa, H. Kobayashi: A fast ray frustum-triangle intersection "
        "algorithm with precomputation and early termination. IPSJ Transactions on Advanced Computing Systems 1(1), 2008."
    ),
    "laine-karras-2011": (
        "S. Laine, T. Karras: Stratified sampling for stochastic transparency. Eurographics Symposium on Rendering 2011."
    ),
    "lambert-1760": "J. H. Lambert: Photometria. 1760.",
    "landis-2002": "H. Landis: Production-ready global illumination. SIGGRAPH course 16, 2002.",
    "lauterbach-2006": (
        "C. Lauterbach, S.-E. Yoon, D. Tuft, D. Manocha: RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs. "
        "IEEE Symposium on Interactive Ray Tracing 2006."
    ),
    "li-2018": (
        "T.-M. Li, M. Aittala, F. Durand, J. Lehtinen: Differentiable Monte Carlo ray tracing through edge sampling. ACM "
        "Transactions on Graphics 37(6), 2018."
    ),
    "livox-2019": "Livox: Mid series user manual, 2019.",
    "lloyd-1982": "S. P. Lloyd: Least squares quantization in PCM. IEEE Transactions on Information Theory 28(2), 1982.",
    "lu-2020": (
        "H. J. Lu, M. Matz, M. Girkar, J. Hubička, A. Jaeger, M. Mitchell (editors): System V Application Binary "
        "Interface, AMD64 Architecture Processor Supplement, 2020."
    ),
    "macdonald-booth-1990": (
        "J. D. MacDonald, K. S. Booth: Heuristics for ray tracing using space subdivision. The Visual Computer 6, 1990."
    ),
    "mahovsky-wyvill-2006": (
        "J. Mahovsky, B. Wyvill: Memory-conserving bounding volume hierarchies with coherent raytracing. Computer "
        "Graphics Forum 25(2), 2006."
    ),
    "mansson-2007": (
        "E. Månsson, J. Munkberg, T. Akenine-Möller: Deep coherent ray tracing. IEEE Symposium on Interactive Ray Tracing 2007."
    ),
    "meister-bittner-2018": (
        "D. Meister, J. Bittner: Parallel reinsertion for bounding volume hierarchy optimization. Computer Graphics Forum "
        "37(2), 2018."
    ),
    "meister-bittner-2018-ploc": (
        "D. Meister, J. Bittner: Parallel locally-ordered clustering for bounding volume hierarchy construction. IEEE "
        "Transactions on Visualization and Computer Graphics 24(3), 2018."
    ),
    "meisters-1975": "G. H. Meisters: Polygons have ears. The American Mathematical Monthly 82(6), 1975.",
    "merrill-garland-2016": (
        "D. Merrill, M. Garland: Single-pass parallel prefix scan with decoupled look-back. NVIDIA technical report "
        "NVR-2016-002, 2016."
    ),
    "moeller-trumbore-1997": (
        "T. Moeller, B. Trumbore: Fast, minimum storage ray/triangle intersection. Journal of Graphics Tools 2(1), 1997."
    ),
    "morton-1966": "G. M. Morton: A computer oriented geodetic data base and a new technique in file sequencing. IBM, 1966.",
    "narkowicz-2016": "K. Narkowicz: ACES filmic tone mapping curve. 2016.",
    "navratil-2007": (
        "P. A. Navrátil, D. S. Fussell, C. Lin, W. R. Mark: Dynamic ray scheduling to improve ray coherence and bandwidth "
        "utilization. IEEE Symposium on Interactive Ray Tracing 2007."
    ),
    "navratil-2010": "P. A. Navrátil: Memory-efficient, scalable ray tracing. PhD thesis, University of Texas at Austin, 2010.",
    "newell-1975": (
        "M. E. Newell: The utilization of procedure models in digital image synthesis. PhD thesis, University of Utah, 1975."
    ),
    "nunes-santos-2009": (
        "M. Nunes, L. P. Santos: Workload distribution for ray tracing in multi-core systems. Encontro Portugues de "
        "Computacao Grafica, 2009."
    ),
    "opencv": "OpenCV: camera calibration and 3D reconstruction; fisheye camera model.",
    "ouster": "Ouster: OS1 data sheet of the first generation; default beam angles of that generation in the maker's SDK.",
    "overbeck-2008": (
        "R. Overbeck, R. Ramamoorthi, W. R. Mark: Large ray packets for real-time Whitted ray tracing. IEEE Symposium on "
        "Interactive Ray Tracing 2008."
    ),
    "owen-1995": "A. B. Owen: Randomly permuted (t,m,s)-nets and (t,s)-sequences. MCQMC 1995.",
    "parker-1999": "S. Parker, W. Martin, P.-P. J. Sloan, P. Shirley, B. Smits, C. Hansen: Interactive ray tracing. I3D 1999.",
    "pcl-pcd": ("Point Cloud Library: The PCD (Point Cloud Data) file format, version 0.7."),
    "pharr-1997": (
        "M. Pharr, C. Kolb, R. Gershbein, P. Hanrahan: Rendering complex scenes with memory-coherent ray tracing. "
        "SIGGRAPH 1997."
    ),
    "pharr-2016": (
        "M. Pharr, W. Jakob, G. Humphreys: Physically based rendering: from theory to implementation, 3rd edition. Morgan "
        "Kaufmann, 2016."
    ),
    "pharr-humphreys-2004": "M. Pharr, G. Humphreys: Physically based rendering. Morgan Kaufmann, 2004.",
    "pichler-2018": "T. A. Pichler: Fast CPU Ray-Triangle Intersection Method. Diploma thesis, TU Wien, 2018.",
    "polychronopoulos-kuck-1987": (
        "C. D. Polychronopoulos, D. J. Kuck: Guided self-scheduling: a practical scheduling scheme for parallel "
        "supercomputers. IEEE Transactions on Computers C-36(12), 1987."
    ),
    "popov-2006": (
        "S. Popov, J. Guenther, H.-P. Seidel, P. Slusallek: Experiences with streaming construction of SAH KD-trees. IEEE "
        "Symposium on Interactive Ray Tracing 2006."
    ),
    "popov-2009": (
        "S. Popov, I. Georgiev, R. Dimov, P. Slusallek: Object partitioning considered harmful: space subdivision for "
        "BVHs. High Performance Graphics 2009."
    ),
    "potmesil-chakravarty-1981": (
        "M. Potmesil, I. Chakravarty: A lens and aperture camera model for synthetic image generation. SIGGRAPH 1981."
    ),
    "prokop-1999": "H. Prokop: Cache-oblivious algorithms. M.Sc. thesis, Massachusetts Institute of Technology, 1999.",
    "prusinkiewicz-lindenmayer-1990": "P. Prusinkiewicz, A. Lindenmayer: The algorithmic beauty of plants. Springer, 1990.",
    "quinlan-1994": (
        "S. Quinlan: Efficient distance computation between non-convex objects. IEEE International Conference on Robotics and "
        "Automation, 1994."
    ),
    "rahikainen-2013": "V. Rahikainen: On real-time ray tracing. M.Sc. thesis, University of Tampere, 2013.",
    "ramani-2009": (
        "K. Ramani, C. P. Gribble, A. Davis: StreamRay: a stream filtering architecture for coherent ray tracing. ASPLOS 2009."
    ),
    "reinhard-2002": (
        "E. Reinhard, M. Stark, P. Shirley, J. Ferwerda: Photographic tone reproduction for digital images. SIGGRAPH 2002."
    ),
    "reshetov-2005": "A. Reshetov, A. Soupikov, J. Hurley: Multi-level ray tracing algorithm. SIGGRAPH 2005.",
    "reshetov-2006": (
        "A. Reshetov: Omnidirectional ray tracing traversal algorithm for kd-trees. IEEE Symposium on Interactive Ray "
        "Tracing 2006."
    ),
    "reshetov-2007": (
        "A. Reshetov: Faster ray packets - triangle intersection through vertex culling. IEEE Symposium on Interactive "
        "Ray Tracing 2007."
    ),
    "robosense": "RoboSense: RS-LiDAR-M1 user guide.",
    "rubin-whitted-1980": (
        "S. M. Rubin, T. Whitted: A 3-dimensional representation for fast rendering of complex scenes. SIGGRAPH 1980."
    ),
    "salmon-2011": (
        "J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw: Parallel random numbers: as easy as 1, 2, 3. International "
        "Conference for High Performance Computing, Networking, Storage and Analysis (SC), 2011."
    ),
    "schlick-1994": (
        "C. Schlick: An inexpensive BRDF model for physically-based rendering. Computer Graphics Forum 13(3), 1994."
    ),
    "schmalstieg-tobler-1999": (
        "D. Schmalstieg, R. F. Tobler: Real-time bounding box area computation. TU Wien, Technical Report TR-186-2-99-10, 1999."
    ),
    "schmidt-budge-2002": (
        "C. M. Schmidt, B. Budge: Simple nested dielectrics in ray traced images. Journal of Graphics Tools 7(2), 2002."
    ),
    "segura-feito-1998": (
        "R. J. Segura, F. R. Feito: An algorithm for determining intersection segment-polygon in 3D. Computers & Graphics "
        "22(5), 1998."
    ),
    "segura-feito-2001": (
        "R. J. Segura, F. R. Feito: Algorithms to test ray-triangle intersection. Comparative study. WSCG 2001."
    ),
    "shapira-2008": (
        "L. Shapira, A. Shamir, D. Cohen-Or: Consistent mesh partitioning and skeletonisation using the shape diameter "
        "function. The Visual Computer 24(4), 2008."
    ),
    "shevtsov-2007-kdtree": (
        "M. Shevtsov, A. Soupikov, A. Kapustin: Highly parallel fast KD-tree construction for interactive ray tracing of "
        "dynamic scenes. Computer Graphics Forum 26(3), 2007."
    ),
    "shevtsov-2007-triangle": (
        "M. Shevtsov, A. Soupikov, A. Kapustin: Ray-triangle intersection algorithm for modern CPU architectures. "
        "GraphiCon 2007."
    ),
    "shewchuk-1997": (
        "J. R. Shewchuk: Adaptive precision floating-point arithmetic and fast robust geometric predicates. Discrete & "
        "Computational Geometry 18(3), 1997."
    ),
    "shimrat-1962": "M. Shimrat: Algorithm 112: Position of point relative to polygon. Communications of the ACM 5(8), 1962.",
    "shirley-1991": "P. Shirley: Discrepancy as a quality measure for sample distributions. Eurographics 1991.",
    "shirley-1996": (
        "P. Shirley, C. Wang, K. Zimmerman: Monte Carlo techniques for direct lighting calculations. ACM Transactions on "
        "Graphics 15(1), 1996."
    ),
    "shirley-chiu-1997": (
        "P. Shirley, K. Chiu: A low distortion map between disk and square. Journal of Graphics Tools 2(3), 1997."
    ),
    "shoemake-1985": "K. Shoemake: Animating rotation with quaternion curves. SIGGRAPH 1985.",
    "shoemake-1998": "K. Shoemake: Pluecker coordinate tutorial. Ray Tracing News 11(1), 1998.",
    "smith-1967": (
        "B. Smith: Geometrical shadowing of a random rough surface. IEEE Transactions on Antennas and Propagation 15(5), 1967."
    ),
    "sobol-1967": (
        "I. M. Sobol: On the distribution of points in a cube and the approximate evaluation of integrals. USSR "
        "Computational Mathematics and Mathematical Physics 7(4), 1967."
    ),
    "soupikov-2008": (
        "A. Soupikov, M. Shevtsov, A. Kapustin: Improving kd-tree quality at a reasonable construction cost. IEEE "
        "Symposium on Interactive Ray Tracing 2008."
    ),
    "stich-2009": (
        "M. Stich, H. Friedrich, A. Dietrich: Spatial splits in bounding volume hierarchies. High Performance Graphics 2009."
    ),
    "sutherland-1974": (
        "I. E. Sutherland, R. F. Sproull, R. A. Schumacker: A characterization of ten hidden-surface algorithms. ACM "
        "Computing Surveys 6(1), 1974."
    ),
    "sutherland-hodgman-1974": (
        "I. E. Sutherland, G. W. Hodgman: Reentrant polygon clipping. Communications of the ACM 17(1), 1974."
    ),
    "tessari-2023": (
        "L. Tessari, A. Dittebrandt, M. J. Doyle, C. Benthin: Stochastic subsets for BVH construction. Computer Graphics "
        "Forum 42(2), 2023."
    ),
    "thuermer-wuethrich-1998": (
        "G. Thuermer, C. A. Wuethrich: Computing vertex normals from polygonal facets. Journal of Graphics Tools 3(1), 1998."
    ),
    "trowbridge-reitz-1975": (
        "T. S. Trowbridge, K. P. Reitz: Average irregularity representation of a rough surface. Journal of the Optical "
        "Society of America 65(5), 1975."
    ),
    "turk-1990": "G. Turk: Generating random points in triangles. Graphics Gems, 1990.",
    "turk-1994": "G. Turk: The PLY polygon file format. Stanford University, 1994.",
    "urena-2013": (
        "C. Urena, M. Fajardo, A. King: An area-preserving parametrization for spherical rectangles. Computer Graphics "
        "Forum 32(4) (Eurographics Symposium on Rendering), 2013."
    ),
    "usenko-2018": (
        "V. Usenko, N. Demmel, D. Cremers: The double sphere camera model. International Conference on 3D Vision, 2018."
    ),
    "van-oosterom-strackee-1983": (
        "A. van Oosterom, J. Strackee: The solid angle of a plane triangle. IEEE Transactions on Biomedical Engineering "
        "30(2), 1983."
    ),
    "veach-1997": "E. Veach: Robust Monte Carlo methods for light transport simulation. Thesis, Stanford University, 1997.",
    "veach-guibas-1995": (
        "E. Veach, L. J. Guibas: Optimally combining sampling techniques for Monte Carlo rendering. SIGGRAPH 1995."
    ),
    "velodyne": "Velodyne: VLP-16 user manual, 63-9243; HDL-32E user's manual and programming guide, 63-9113.",
    "vinkler-2017": (
        "M. Vinkler, J. Bittner, V. Havran: Extended Morton codes for high performance bounding volume hierarchy "
        "construction. High Performance Graphics 2017."
    ),
    "vogel-1979": "H. Vogel: A better way to construct the sunflower head. Mathematical Biosciences 44(3-4), 1979.",
    "waechter-2004": "C. Waechter: Realtime ray tracing. Diploma thesis, Ulm University, 2004.",
    "waechter-binder-2019": (
        "C. Waechter, N. Binder: A fast and robust method for avoiding self-intersection. Ray Tracing Gems, 2019."
    ),
    "wagner-2006": (
        "W. Wagner, A. Ullrich, V. Ducic, T. Melzer, N. Studnicka: Gaussian decomposition and calibration of a novel "
        "small-footprint full-waveform digitising airborne laser scanner. ISPRS Journal of Photogrammetry and Remote "
        "Sensing 60(2), 2006."
    ),
    "wald-2001": (
        "I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001."
    ),
    "wald-2003": (
        "I. Wald, C. Benthin, P. Slusallek: Distributed interactive ray tracing of dynamic scenes. IEEE Symposium on "
        "Parallel and Large-Data Visualization and Graphics 2003."
    ),
    "wald-2004": "I. Wald: Realtime ray tracing and interactive global illumination. PhD thesis, Saarland University, 2004.",
    "wald-2007-deformable": (
        "I. Wald, S. Boulos, P. Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies. ACM "
        "Transactions on Graphics 26(1), 2007."
    ),
    "wald-2007-sah": (
        "I. Wald: On fast construction of SAH-based bounding volume hierarchies. IEEE Symposium on Interactive Ray "
        "Tracing 2007."
    ),
    "wald-2007-streams": (
        "I. Wald, C. P. Gribble, S. Boulos, A. Kensler: SIMD ray stream tracing - SIMD ray traversal with generalized ray "
        "packets and on-the-fly re-ordering. Technical report UUSCI-2007-012, University of Utah, 2007."
    ),
    "wald-2008": (
        "I. Wald, C. Benthin, S. Boulos: Getting rid of packets: efficient SIMD single-ray traversal using multi- "
        "branching BVHs. IEEE Symposium on Interactive Ray Tracing 2008."
    ),
    "wald-2014": (
        "I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst: Embree: a kernel framework for efficient CPU ray tracing. "
        "ACM Transactions on Graphics 33(4), 2014."
    ),
    "wald-havran-2006": (
        "I. Wald, V. Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N). IEEE Symposium "
        "on Interactive Ray Tracing 2006."
    ),
    "walter-2007": (
        "B. Walter, S. Marschner, H. Li, K. Torrance: Microfacet models for refraction through rough surfaces. EGSR 2007."
    ),
    "wavefront-technologies-1992": (
        "Wavefront Technologies: Advanced Visualizer manual, appendix B1: Object files (.obj). 1992."
    ),
    "wavefront-technologies-1995": "Wavefront Technologies: Advanced Visualizer manual, appendix: MTL material format. 1995.",
    "whitted-1980": "T. Whitted: An improved illumination model for shaded display. Communications of the ACM 23(6), 1980.",
    "williams-2005": (
        "A. Williams, S. Barrus, R. K. Morley, P. Shirley: An efficient and robust ray-box intersection algorithm. "
        "Journal of Graphics Tools 10(1), 2005."
    ),
    "woop-2013": (
        "S. Woop, C. Benthin, I. Wald: Watertight ray/triangle intersection. Journal of Computer Graphics Techniques "
        "2(1), 2013."
    ),
    "yang-2008": (
        "X. Yang, D. Xu, L. Zhao: Ray tracing dynamic scenes using fast KD-tree base on multi-core architectures. "
        "International Conference on Computer Science and Software Engineering 2008."
    ),
    "ylitie-2017": (
        "H. Ylitie, T. Karras, S. Laine: Efficient incoherent ray traversal on GPUs through compressed wide BVHs. High "
        "Performance Graphics 2017."
    ),
    "zagha-blelloch-1991": "M. Zagha, G. E. Blelloch: Radix sort for vector multiprocessors. Supercomputing 1991.",
    "zhou-2018": "Q.-Y. Zhou, J. Park, V. Koltun: Open3D: A modern library for 3D data processing. arXiv:1801.09847, 2018.",
    "zhukov-1998": (
        "S. Zhukov, A. Iones, G. Kronin: An ambient light illumination model. Eurographics Workshop on Rendering, 1998."
    ),
}
"""Authors, title, venue and year by key."""
