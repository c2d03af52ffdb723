# From the repository's root: build/release/bin/joint_continuity fitting/figures && gnuplot fitting/figures/joint_continuity.gnuplot
set terminal svg size 760,520 font "sans,13" background rgb "white"
set output "fitting/figures/joint_continuity.svg"
set datafile separator ","
set logscale xy
set xlabel "coefficients around"
set ylabel "largest error (mm)"
set format y "10^{%L}"
set xtics (8, 16, 32, 64, 128, 256)
set xrange [7:300]
set yrange [1e-11:10]
set grid
set key bottom left
of(space, degree) = sprintf("< grep '^%s,%d,' fitting/figures/joint_continuity.csv", space, degree)
plot of("thesis", 3) using 3:4 with linespoints pt 6 lc rgb "#b03030" title "simple knots, degree 3", \
     of("thesis", 5) using 3:4 with linespoints pt 4 lc rgb "#d08080" title "simple knots, degree 5", \
     of("curvature", 3) using 3:4 with linespoints pt 7 lc rgb "#206040" title "curvature continuous, degree 3", \
     of("curvature", 4) using 3:4 with linespoints pt 9 lc rgb "#3a9060" title "curvature continuous, degree 4", \
     of("curvature", 5) using 3:4 with linespoints pt 5 lc rgb "#70c090" title "curvature continuous, degree 5", \
     [30:300] 3.5 * x**-2 with lines dt 2 lc rgb "#808080" title "h^2", \
     [30:300] 3100 * x**-4 with lines dt 3 lc rgb "#808080" title "h^4"
