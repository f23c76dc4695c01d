// The host adds nothing: its commands are those of the plugins called as Nav2's servers call them.
//
// observations.bin is what a robot observed on three drives, made by record.py. The direct way below is written out
// plainly, without the host.

#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "nav2_lockstep/navigator.hpp"

using geometry_msgs::msg::Twist;
using nav2_lockstep::Navigator;
using nav2_lockstep::Observation;
using nav2_lockstep::Settings;
using nav2_lockstep::make_costmap;
#if NAV2_MINOR < 5
namespace nav2 = nav2_util;
#endif

namespace
{

constexpr double kReplan_s = 1.0;
// In observations, of which there are 20 a second: between two plans, and between two updates of a costmap, of which
// common.yaml wants 10 and 2 a second.
constexpr int kReplan = 20, kLocalUpdate = 2, kGlobalUpdate = 10;
constexpr double kLidarX_m = 0.055;

geometry_msgs::msg::Transform mount()
{
  geometry_msgs::msg::Transform transform;
  transform.translation.x = kLidarX_m;
  transform.translation.z = 0.241;
  return transform;
}

geometry_msgs::msg::Quaternion heading(double yaw)
{
  geometry_msgs::msg::Quaternion rotation;
  rotation.z = std::sin(0.5 * yaw);
  rotation.w = std::cos(0.5 * yaw);
  return rotation;
}

geometry_msgs::msg::PoseStamped goal_at(double x, double y)
{
  geometry_msgs::msg::PoseStamped pose;
  pose.header.frame_id = "odom";
  pose.pose.position.x = x;
  pose.pose.position.y = y;
  return pose;
}

struct Drive
{
  geometry_msgs::msg::PoseStamped goal;
  std::vector<Observation> observations;
};

// Reads little-endian numbers one after the other.
class Reader
{
public:
  explicit Reader(const std::string & path)
  {
    std::ifstream file(path, std::ios::binary);
    bytes_.assign(std::istreambuf_iterator<char>(file), {});
  }

  bool at_end() const {return at_ >= bytes_.size();}

  template<typename Number>
  Number next()
  {
    Number number;
    if (at_ + sizeof(number) > bytes_.size()) {
      throw std::runtime_error("observations.bin ends too early");
    }
    std::memcpy(&number, bytes_.data() + at_, sizeof(number));
    at_ += sizeof(number);
    return number;
  }

private:
  std::vector<char> bytes_;
  std::size_t at_ = 0;
};

Drive read_drive(Reader & reader)
{
  Drive drive;
  const auto number = reader.next<std::int32_t>(), beams = reader.next<std::int32_t>();
  sensor_msgs::msg::LaserScan scan;
  scan.header.frame_id = "lidar_link";
  scan.angle_min = reader.next<float>();
  scan.angle_increment = reader.next<float>();
  scan.angle_max = scan.angle_min + (beams - 1) * scan.angle_increment;
  scan.range_min = reader.next<float>();
  scan.range_max = reader.next<float>();
  const double goal_x = reader.next<double>(), goal_y = reader.next<double>();
  drive.goal = goal_at(goal_x, goal_y);
  for (int i = 0; i < number; ++i) {
    const rclcpp::Time stamp(reader.next<std::int64_t>(), RCL_ROS_TIME);
    Observation observation;
    auto & odometry = observation.odometry;
    odometry.header.stamp = scan.header.stamp = stamp;
    odometry.header.frame_id = "odom";
    odometry.child_frame_id = "base_link";
    odometry.pose.pose.position.x = reader.next<double>();
    odometry.pose.pose.position.y = reader.next<double>();
    odometry.pose.pose.orientation = heading(reader.next<double>());
    odometry.twist.twist.linear.x = reader.next<double>();
    odometry.twist.twist.angular.z = reader.next<double>();
    scan.ranges.clear();
    for (int beam = 0; beam < beams; ++beam) {
      scan.ranges.push_back(reader.next<float>());
    }
    observation.scan = std::make_shared<sensor_msgs::msg::LaserScan>(scan);
    drive.observations.push_back(observation);
  }
  return drive;
}

std::vector<Drive> recorded()
{
  Reader reader(OBSERVATIONS);
  std::vector<Drive> drives;
  while (!reader.at_end()) {
    drives.push_back(read_drive(reader));
  }
  return drives;
}

// Gives access to what a layer's subscriptions fill.
struct Buffers : nav2_costmap_2d::ObstacleLayer
{
  static auto & of(nav2_costmap_2d::ObstacleLayer & layer)
  {
    return layer.*(&Buffers::observation_buffers_);
  }
};

// The plugins, asked without the host.
class Direct
{
public:
  explicit Direct(const geometry_msgs::msg::PoseStamped & goal)
  : goal_(goal),
    controllers_("nav2_core", "nav2_core::Controller"),
    planners_("nav2_core", "nav2_core::GlobalPlanner"),
#if NAV2_MINOR >= 5
    handlers_("nav2_core", "nav2_core::PathHandler"),
#endif
    goals_("nav2_core", "nav2_core::GoalChecker")
  {
    for (auto * costmap : {&local_, &global_}) {
      override_clock(**costmap);
      (*costmap)->configure();
      (*costmap)->getTfBuffer()->setUsingDedicatedThread(true);
    }
    override_clock(*node_);
    node_->declare_parameter("controller_frequency", 20.0);
    min_x_ = node_->declare_parameter("min_x_velocity_threshold", 0.0001);
    min_y_ = node_->declare_parameter("min_y_velocity_threshold", 0.0001);
    min_theta_ = node_->declare_parameter("min_theta_velocity_threshold", 0.0001);
    goal_checker_ = goals_.createSharedInstance(nav2::get_plugin_type_param(node_, "goal_checker"));
    goal_checker_->initialize(node_, "goal_checker", local_);
#if NAV2_MINOR >= 5
    path_handler_ = handlers_.createSharedInstance("nav2_controller::FeasiblePathHandler");
    path_handler_->initialize(node_, node_->get_logger(), "PathHandler", local_, local_->getTfBuffer());
#endif
    controller_ = controllers_.createSharedInstance(nav2::get_plugin_type_param(node_, "FollowPath"));
    controller_->configure(node_, "FollowPath", local_->getTfBuffer(), local_);
    controller_->activate();
    planner_ = planners_.createSharedInstance(nav2::get_plugin_type_param(server_, "GridBased"));
    planner_->configure(server_, "GridBased", global_->getTfBuffer(), global_);
    planner_->activate();
  }

  Twist step(const Observation & observation, int number)
  {
    const rclcpp::Time now(observation.scan->header.stamp, RCL_ROS_TIME);
    set_clock(*node_, now);
    for (const auto & [costmap, every] : {std::pair(local_, kLocalUpdate), std::pair(global_, kGlobalUpdate)}) {
      set_clock(*costmap, now);
      geometry_msgs::msg::TransformStamped transform;
      transform.header.stamp = now;
      transform.header.frame_id = "base_link";
      transform.child_frame_id = "lidar_link";
      transform.transform = mount();
      costmap->getTfBuffer()->setTransform(transform, "test", true);
      transform.header.frame_id = "odom";
      transform.child_frame_id = "base_link";
      transform.transform.translation.x = observation.odometry.pose.pose.position.x;
      transform.transform.translation.y = observation.odometry.pose.pose.position.y;
      transform.transform.translation.z = 0.0;
      transform.transform.rotation = observation.odometry.pose.pose.orientation;
      costmap->getTfBuffer()->setTransform(transform, "test", false);
      auto layer = std::dynamic_pointer_cast<nav2_costmap_2d::ObstacleLayer>(
        costmap->getLayeredCostmap()->getPlugins()->front());
      layer->laserScanValidInfCallback(observation.scan, Buffers::of(*layer).front());
      if (number % every == 0) {
        costmap->updateMap();
      }
    }
    geometry_msgs::msg::PoseStamped pose;
    if (number % kReplan == 0) {
      EXPECT_TRUE(global_->getRobotPose(pose));
#if NAV2_MINOR >= 5
      plan_ = planner_->createPlan(pose, goal_, {}, [] {return false;});
      controller_->newPathReceived(plan_);
      path_handler_->setPlan(plan_);
#else
      plan_ = planner_->createPlan(pose, goal_, [] {return false;});
      controller_->setPlan(plan_);
#endif
      goal_checker_->reset();
    }
    EXPECT_TRUE(local_->getRobotPose(pose));
    Twist velocity = observation.odometry.twist.twist;
    velocity.linear.x = std::abs(velocity.linear.x) > min_x_ ? velocity.linear.x : 0.0;
    velocity.linear.y = std::abs(velocity.linear.y) > min_y_ ? velocity.linear.y : 0.0;
    velocity.angular.z = std::abs(velocity.angular.z) > min_theta_ ? velocity.angular.z : 0.0;
    const auto & end = plan_.poses.back().pose;
#if NAV2_MINOR >= 5
    reached_ = reached_ || goal_checker_->isGoalReached(pose.pose, end, velocity, local_plan_);
#else
    reached_ = reached_ || goal_checker_->isGoalReached(pose.pose, end, velocity);
#endif
    if (reached_) {
      return Twist();
    }
#if NAV2_MINOR >= 5
    const auto goal = path_handler_->getTransformedGoal(pose.header.stamp);
    const auto segment = path_handler_->findPlanSegment(pose);
    local_plan_ = path_handler_->transformLocalPlan(segment.first, segment.second);
    return controller_->computeVelocityCommands(pose, velocity, goal_checker_.get(), local_plan_, goal).twist;
#else
    return controller_->computeVelocityCommands(pose, velocity, goal_checker_.get()).twist;
#endif
  }

private:
  template<typename Node>
  static void override_clock(Node & node)
  {
    ASSERT_EQ(rcl_enable_ros_time_override(node.get_clock()->get_clock_handle()), RCL_RET_OK);
  }

  template<typename Node>
  static void set_clock(Node & node, const rclcpp::Time & now)
  {
    ASSERT_EQ(
      rcl_set_ros_time_override(node.get_clock()->get_clock_handle(), now.nanoseconds()), RCL_RET_OK);
  }

  geometry_msgs::msg::PoseStamped goal_;
  std::shared_ptr<nav2_costmap_2d::Costmap2DROS> local_{make_costmap("local_costmap")};
  std::shared_ptr<nav2_costmap_2d::Costmap2DROS> global_{make_costmap("global_costmap")};
  nav2::LifecycleNode::SharedPtr node_{
    std::make_shared<nav2::LifecycleNode>("controller_server")};
  nav2::LifecycleNode::SharedPtr server_{
    std::make_shared<nav2::LifecycleNode>("planner_server")};
  pluginlib::ClassLoader<nav2_core::Controller> controllers_;
  pluginlib::ClassLoader<nav2_core::GlobalPlanner> planners_;
#if NAV2_MINOR >= 5
  pluginlib::ClassLoader<nav2_core::PathHandler> handlers_;
  std::shared_ptr<nav2_core::PathHandler> path_handler_;
  nav_msgs::msg::Path local_plan_;
#endif
  pluginlib::ClassLoader<nav2_core::GoalChecker> goals_;
  std::shared_ptr<nav2_core::Controller> controller_;
  std::shared_ptr<nav2_core::GlobalPlanner> planner_;
  std::shared_ptr<nav2_core::GoalChecker> goal_checker_;
  double min_x_, min_y_, min_theta_;
  nav_msgs::msg::Path plan_;
  bool reached_ = false;
};

class WithParameters : public testing::TestWithParam<const char *>
{
protected:
  void SetUp() override
  {
    std::vector<std::string> arguments{"test", "--ros-args"};
    for (const std::string name : {"common", "mapless", GetParam()}) {
      arguments.insert(arguments.end(), {"--params-file", PARAMS + name + ".yaml"});
    }
    std::vector<const char *> raw;
    for (const auto & argument : arguments) {
      raw.push_back(argument.c_str());
    }
    rclcpp::init(static_cast<int>(raw.size()), raw.data());
  }

  void TearDown() override {rclcpp::shutdown();}
};

TEST_P(WithParameters, CommandsAreThoseOfThePluginsCalledDirectly)
{
  int observations = 0, driving = 0;
  for (const auto & drive : recorded()) {
    std::vector<Twist> commands;
    {
      Navigator host(Settings{kReplan_s, mount()});
      host.set_goal(drive.goal);
      for (const auto & observation : drive.observations) {
        commands.push_back(host.step(observation));
        driving += commands.back().linear.x > 0.1;
      }
      EXPECT_EQ(host.failures(), 0);
    }
    Direct direct(drive.goal);
    for (std::size_t i = 0; i < commands.size(); ++i) {
      ASSERT_EQ(direct.step(drive.observations[i], static_cast<int>(i)), commands[i]) << "at observation " << i;
    }
    observations += static_cast<int>(commands.size());
  }
  EXPECT_GE(observations, 1000);
  EXPECT_GT(driving, observations / 2);
}

TEST_P(WithParameters, AsksForWhatItLacks)
{
  const auto drive = recorded().front();
  Navigator host(Settings{kReplan_s, mount()});
  EXPECT_EQ(host.missing(), "no goal yet");
  EXPECT_EQ(host.step(drive.observations.front()), Twist());
  host.set_goal(drive.goal);
  EXPECT_EQ(host.missing(), "");
}

TEST_P(WithParameters, StandsStillAndPlansAnewWhereThereIsNoWay)
{
  const auto drive = recorded().front();
  Navigator host(Settings{kReplan_s, mount()});
  host.set_goal(goal_at(1000.0, 0.0));  // off the global costmap
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(host.step(drive.observations[i]), Twist());
    EXPECT_EQ(host.failures(), i + 1);
    EXPECT_TRUE(host.plan().poses.empty());
  }
  host.set_goal(drive.goal);
  EXPECT_NE(host.step(drive.observations[3]), Twist());
}

INSTANTIATE_TEST_SUITE_P(
  Controllers, WithParameters, testing::Values("rpp", "dwb", "graceful"),
  [](const auto & info) {return std::string(info.param);});

}  // namespace
