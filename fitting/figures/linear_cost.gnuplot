# From the repository's root: build/release/bin/linear_cost fitting/figures && gnuplot fitting/figures/linear_cost.gnuplot
set terminal svg size 900,420 font "sans,13" background rgb "white"
set output "fitting/figures/linear_cost.svg"
set datafile separator ","
set logscale xy
set format x "10^{%L}"
set format y "10^{%L}"
set grid
set key top left
of(over) = sprintf("< grep '^%s,' fitting/figures/linear_cost.csv", over)
set multiplot layout 1,2
set xlabel "points, at 67 x 64 unknowns"
set ylabel "seconds, gigabytes"
set yrange [1e-4:10]
plot of("points") using 2:4 with linespoints pt 7 lc rgb "#206040" title "sums (s)", \
     of("points") using 2:5 with linespoints pt 5 lc rgb "#b06030" title "sums to surface (s)", \
     of("points") using 2:($6/1024) with linespoints pt 9 lc rgb "#4060a0" title "peak memory (GB)", \
     1e-8 * x with lines dt 2 lc rgb "#808080" title "linear"
set xlabel "unknowns, of 8 million points"
plot of("unknowns") using 3:4 with linespoints pt 7 lc rgb "#206040" title "sums (s)", \
     of("unknowns") using 3:5 with linespoints pt 5 lc rgb "#b06030" title "sums to surface (s)", \
     of("unknowns") using 3:($6/1024) with linespoints pt 9 lc rgb "#4060a0" title "peak memory (GB)", \
     2e-6 * x with lines dt 2 lc rgb "#808080" title "linear"
unset multiplot
