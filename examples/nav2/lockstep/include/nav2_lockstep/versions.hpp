// What differs between Nav2 1.3 (Jazzy), 1.4 (Kilted) and 1.5 (Lyrical). CMakeLists.txt sets NAV2_MINOR.
//
// Only 1.3.13 has been linked and run. All sources and the test also compile to objects with the headers of 1.4.2
// (-std=c++17 -DNAV2_MINOR=4) and 1.5.1 (-std=c++20 -DNAV2_MINOR=5), each as
//
//     g++ -c -std=c++20 -DNAV2_MINOR=5 -Iinclude -isystem NAV2/nav2_core/include ... src/navigator.cpp
//
// but with rclcpp 29.3 instead of the releases' own, with headers of tf2 that forward the new names to the old ones,
// and with Jazzy's common messages. To link, source Kilted or Lyrical and call colcon build as the page does.

#ifndef NAV2_LOCKSTEP__VERSIONS_HPP_
#define NAV2_LOCKSTEP__VERSIONS_HPP_

#include <memory>
#include <string>

#include "nav2_costmap_2d/costmap_2d_ros.hpp"
#if NAV2_MINOR >= 5
#include "nav2_core/path_handler.hpp"
#include "nav2_ros_common/lifecycle_node.hpp"
#include "nav2_ros_common/node_utils.hpp"
#else
#include "nav2_util/lifecycle_node.hpp"
#include "nav2_util/node_utils.hpp"
#endif

namespace nav2_lockstep
{

#if NAV2_MINOR < 5
namespace nav2 = nav2_util;
#endif

// The node NAME/NAME of a costmap.
inline std::shared_ptr<nav2_costmap_2d::Costmap2DROS> make_costmap(const std::string & name)
{
#if NAV2_MINOR >= 4
  return std::make_shared<nav2_costmap_2d::Costmap2DROS>(name, "/", false);
#else
  return std::make_shared<nav2_costmap_2d::Costmap2DROS>(name, "/", name, false);
#endif
}

}  // namespace nav2_lockstep

#endif  // NAV2_LOCKSTEP__VERSIONS_HPP_
