#!/bin/sh
# Answers as ffmpeg does, by the files beside its input: list.sh and frames.sh.
case "$*" in
*-version*)
    echo 'ffmpeg version n7.1 Copyright'
    exit
    ;;
esac
for argument; do
    case "$argument" in
    file:*) folder=$(dirname "${argument#file:}") ;;
    esac
done
echo "$@" >> "$folder/calls"
case "$*" in
*framecrc*) . "$folder/list.sh" ;;
*yuv4mpegpipe*) . "$folder/frames.sh" ;;
esac
