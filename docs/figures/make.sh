#!/bin/sh
# Draw every figure of docs/gallery.md and docs/skills.md from the shipped weights, or from runs/
# where that exists.  Run it from the root of the repository:  sh docs/figures/make.sh
# Each line is the command that stands under its figure; the SVG twins are not kept here.
set -e
agility-ref plot courses --out docs/figures/courses.png
agility-ref plot skills --difficulty 0.5 --out docs/figures/skills.png
agility-ref plot strobe oracle --environment climb-gap --difficulty 0.5 --course 2 --out docs/figures/strobe.png
agility-ref plot strobe distilled --environment climb-gap --difficulty 0.5 --course 3 --out docs/figures/strobe-distilled.png
agility-ref plot strobe gen-5 --environment beam --difficulty 0.5 --out docs/figures/strobe-beam.png
agility-ref plot oracle-map oracle --environment climb-gap --out docs/figures/oracle-map.png
agility-ref plot oracle-map ps-rl-3 --environment climb-gap --out docs/figures/selector-map.png
agility-ref plot episode walk --environment walk --out docs/figures/episode.png
agility-ref plot curves agility_ref/weights/gen-3-full-seed0.npz agility_ref/weights/gen-5-full-seed0.npz agility_ref/weights/climb-up-full-seed0.npz agility_ref/weights/climb-down-full-seed0.npz agility_ref/weights/leap-full-seed0.npz agility_ref/weights/beam-full-seed0.npz --out docs/figures/curves.png
agility-ref video oracle --environment climb-gap --difficulty 0.3 --course 2 --seconds 6 --fps 12 --quality 40 --out docs/figures/oracle.webp
agility-ref video gen-5 --environment beam --difficulty 0.5 --seconds 6 --fps 12 --quality 40 --out docs/figures/beam.webp
for d in 0.5 1; do
  agility-ref plot strobe walk --environment walk --difficulty $d --out docs/figures/walk-$d.png
  agility-ref plot strobe climb --environment climb --difficulty $d --out docs/figures/climb-$d.png
  agility-ref plot strobe leap --environment gap --difficulty $d --out docs/figures/leap-$d.png
  agility-ref plot strobe climb-up --environment climb-up --difficulty $d --out docs/figures/climb-up-$d.png
  agility-ref plot strobe climb-down --environment climb-down --difficulty $d --out docs/figures/climb-down-$d.png
  agility-ref plot strobe beam --environment beam --difficulty $d --out docs/figures/beam-$d.png
done
agility-ref video climb --environment climb --difficulty 1 --seconds 13 --fps 12 --quality 40 --out docs/figures/climb.webp
find docs/figures -name "*.svg" ! -name framework.svg ! -name workflow.svg -delete
