# The demo on ROS 2 Jazzy:
#   docker build -t icu-gantry . && docker run --rm -it --shm-size=1g --network host icu-gantry
# Pictures go through shared memory, of which docker gives 64 MB unless told otherwise. The page is served on
# 127.0.0.1:8080, which --network host makes this machine's.
FROM ros:jazzy-ros-base AS tools
RUN apt-get update && apt-get install -y --no-install-recommends \
      iproute2 make python3-pip python3-venv ros-jazzy-rosbag2 \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /icu_gantry
COPY src src
RUN apt-get update && rosdep update --rosdistro jazzy \
 && rosdep install --from-paths src --ignore-src -y --skip-keys python3-numba \
 && rm -rf /var/lib/apt/lists/*

FROM tools AS demo
COPY . .
RUN bash -c 'source /opt/ros/jazzy/setup.bash && scripts/setup.sh'
ENTRYPOINT ["bash", "-c", "source /opt/ros/jazzy/setup.bash && exec ros2_ws/install/icu_bringup/lib/icu_bringup/bring_up \"$@\"", "bring_up"]
CMD ["--profile", "bench", "--prepare"]
